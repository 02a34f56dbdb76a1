"""Files that people edit: strict schemas and their domain objects. Only this package imports pydantic."""
