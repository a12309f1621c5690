//! Ports, the device client and the virtual finger.
