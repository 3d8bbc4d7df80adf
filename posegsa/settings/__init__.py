"""The building blocks of all settings: checked fields, and error messages."""
