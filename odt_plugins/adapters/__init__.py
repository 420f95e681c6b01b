"""One file per toolkit; each imports its toolkit only when it is called."""
