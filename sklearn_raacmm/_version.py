"""The version of the package: all that need it read it here."""

__version__ = "0.1.0.dev0"
