"""Pictures for people, with axes and colours."""
