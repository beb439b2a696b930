"""What people see of a press: score maps in colour, and the picture that is published."""
