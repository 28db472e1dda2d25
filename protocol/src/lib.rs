//! The words that the rig's firmware and the host share.
