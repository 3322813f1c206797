"""Fine Time Measurement (IEEE 802.11-2016, 11.24.6): time stamps, and sessions of frames that contend."""
