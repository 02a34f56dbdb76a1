"""Estimators, which fit the parameters of an arm to joint readings of closed loops.

Shapes: m poses, n joints, U unsensed angles, k closure components, r reduced equations, P parameters, K variances.
"""
