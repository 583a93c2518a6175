//! What every board shares and the robot program need not know.
#![no_std]
