"""How a column is advanced: rates, schemes one a file, the control of the step."""
