"""Results of a fit for use with the arm: corrections of readings, the best D-H table, the tool's uncertainty."""
