//! A webcam of the operating system.
