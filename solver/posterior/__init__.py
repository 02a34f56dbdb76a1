"""Results of a fit where the arm is used: corrections of readings, the best D-H table, the tool's uncertainty."""
