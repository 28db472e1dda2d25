//! Everything of the rig's firmware that needs no chip.
