//! Simulator of the virtual fingertip.
