"""What is it? Numbers that describe a touched object, what is learned of objects by name, and the
answer.
"""
