"""Pictures for a person, with axes and colours."""
