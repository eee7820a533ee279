"""Pure geometry: camera (lens, pose, rays), ground (rays × plane), earth (geodetic ↔ ENU)."""
