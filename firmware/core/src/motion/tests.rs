//! Tests of the motion.
