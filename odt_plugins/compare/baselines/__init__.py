"""One file for every tool that is compared; each alone imports its tool, when it is called."""
