"""Study how well a hand knows the motion of the object that it holds."""
