//! Wi-Fi: station, fall-back access point, provisioning.
