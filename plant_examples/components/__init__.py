"""Unit operations around the screen; a stream is its mass flow rate by size class, kg/s."""
