"""The report as one HTML page: sections, tables, style."""
