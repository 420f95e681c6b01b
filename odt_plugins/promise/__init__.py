"""What every output must keep, checked in numpy alone."""
