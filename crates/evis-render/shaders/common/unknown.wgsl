// Pixels whose light a method does not know.

// Whether a method may leave a pixel unknown; such an instant passes the pixel by.
override MAY_BE_UNKNOWN: bool = false;

fn is_unknown(mean: f32) -> bool {
    return MAY_BE_UNKNOWN && mean < 0.0;
}
