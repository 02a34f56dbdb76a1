"""Files people touch: strict schemas and their domain objects. pydantic stays in here."""
