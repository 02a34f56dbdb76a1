"""Design of a calibration: which joints drive, which poses to take, when to stop. No input or output."""
