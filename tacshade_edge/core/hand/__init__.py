"""What several fingers say together of the object that they hold."""
