"""The Python library; its folder `sarcal` is installed as the package `sarcal`."""
