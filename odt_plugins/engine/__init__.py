"""Arrays in, arrays out: the ODT engine knows no toolkit."""
