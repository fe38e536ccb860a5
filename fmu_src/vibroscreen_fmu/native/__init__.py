"""The native runtime: kernels compiled ahead of time behind the functions of FMI 2.0."""
