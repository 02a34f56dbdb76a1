"""The Python library: the folder `sarcal` is installed as the package `sarcal`. No other package imports it."""
