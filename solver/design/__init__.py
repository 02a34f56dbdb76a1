"""Design of a calibration: choice of the joints to drive and of the poses, and the stop rule. No input or output."""
