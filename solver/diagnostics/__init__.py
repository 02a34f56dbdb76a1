"""Diagnostics of an estimate: identifiability, tests, fault models, outliers, prediction."""
