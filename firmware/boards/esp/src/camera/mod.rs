//! The OV2640 of the XIAO ESP32S3 Sense.
