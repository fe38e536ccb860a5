"""The vibrating screen as an FMI 2.0 co-simulation component."""
