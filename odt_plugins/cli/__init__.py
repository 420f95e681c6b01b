"""The command line ``odt-plugins``. Only here is anything printed."""
