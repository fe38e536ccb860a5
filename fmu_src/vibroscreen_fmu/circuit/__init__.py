"""The units of a circuit as FMUs, and a flowsheet as an SSP."""
