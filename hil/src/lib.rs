//! The bench: one black-box suite for any robot on any broker, and the emulated board as a device.
