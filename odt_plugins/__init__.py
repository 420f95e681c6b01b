"""odt_plugins."""
