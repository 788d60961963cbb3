"""The DIGIT, a fingertip sensor with a camera behind an elastic gel."""
