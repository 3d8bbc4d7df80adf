"""What every settings type is made of: checked fields, and refusals in words."""
