"""Results of a fit for the use of the arm: corrections of readings, the best D-H table, the tool's uncertainty."""
