//! What the numbers of each data set are: attributes `units` and `description`.

use rust_hdf5::{DatatypeMessage, H5Dataset, Hdf5Error};

/// Name of a data set, the end of its path; its unit, `1` for what has none; what it is.
const KNOWN: &[(&str, &str, &str)] = &[
    ("x", "pixel", "column, from 0 at the left"),
    ("y", "pixel", "row, from 0 at the top"),
    ("t", "us", "time since the stream's start; add t_offset for absolute time"),
    ("p", "1", "polarity: ON 1, OFF 0"),
    ("cause", "1", "why an event fired: 0 signal, 1 leak, 2 shot noise, 3 hot pixel"),
    ("width", "pixel", "pixels per row"),
    ("height", "pixel", "rows"),
    ("ms_to_idx", "1", "row ms is the index of the first event with t >= 1000 * ms"),
    ("t_offset", "us", "absolute time of the stream's start"),
    ("fx", "pixel", "focal length along x"),
    ("fy", "pixel", "focal length along y"),
    ("cx", "pixel", "principal point from the left edge; pixel centres at +0.5, subtract 0.5 for OpenCV"),
    ("cy", "pixel", "principal point from the top edge; pixel centres at +0.5, subtract 0.5 for OpenCV"),
    ("distortion_model", "1", "radtan (Brown-Conrady) or fisheye (Kannala-Brandt), as OpenCV has them"),
    ("distortion_coefficients", "1", "in OpenCV's order"),
    ("t_us", "us", "time since the stream's start"),
    ("position", "m", "world from body: origin in the world; right-handed, +Y up, cameras look along -Z"),
    ("rotation_xyzw", "1", "world from body: unit quaternion x, y, z, w"),
    ("linear_velocity", "m/s", "of the body's origin, in world axes"),
    ("angular_velocity", "rad/s", "in world axes"),
    ("box_min", "m", "lowest corner of the box around what is drawn, in the body's axes; NaN for cameras"),
    ("box_max", "m", "highest corner of that box"),
    ("name", "1", "name in the scene"),
    ("instance_id", "1", "id in images of instances; 0 for cameras"),
    ("semantic_id", "1", "id in images of semantic classes; 0 where it has none"),
    ("semantic_name", "1", "name of the semantic class; empty where it has none"),
    ("instance_ids", "1", "ids in images of instances, in the order of instance_names"),
    ("instance_names", "1", "names of instance_ids"),
    ("semantic_ids", "1", "ids in images of semantic classes, in the order of semantic_names"),
    ("semantic_names", "1", "names of semantic_ids"),
    ("accelerometer", "m/s^2", "specific force in the axes of its node: acceleration less gravity"),
    ("gyroscope", "rad/s", "angular rate in the axes of its node"),
    ("names", "1", "what each column of values is"),
    ("values", "1", "what the host gave, in its own units"),
    ("depth", "m", "planar z; +inf where nothing is"),
    ("flow_forward", "pixel", "motion to the next image's time, x right, y down, anchored here"),
    ("flow_backward", "pixel", "motion to the time of the image before, x right, y down, anchored here"),
    ("flow_forward_valid", "1", "1 where flow_forward is defined"),
    ("flow_backward_valid", "1", "1 where flow_backward is defined"),
    ("instance", "1", "instance id; 0 where nothing is"),
    ("semantic", "1", "semantic class; 0 where nothing or nothing labelled is"),
    ("normal", "1", "unit normal in world axes, towards the camera; 0 where nothing is"),
    ("hdr", "scene-referred light", "linear RGB, Rec. 709 primaries"),
    ("frame", "scene-referred light", "mean linear luminance over an exposure"),
    ("seed", "1", "seed of all randomness"),
    ("environment", "1", "index of the environment in its batch"),
    ("complete", "1", "1 once the writer has finished"),
    ("header_hash", "1", "FNV-1a of what the writer said about the recording"),
    ("cameras", "1", "names of the cameras, in order"),
    ("config_toml", "1", "the settings that made the recording, TOML"),
    ("report_json", "1", "counts and measured times, UTF-8 JSON"),
    ("duration_us", "us", "the truth holds for 0 <= t < duration_us"),
    ("threshold_on", "log light", "threshold of ON events in ln(Y / Y_ref + eps)"),
    ("threshold_off", "log light", "threshold of OFF events, a magnitude"),
    ("log_eps", "1", "eps in ln(Y / Y_ref + eps)"),
    ("reference_luminance", "scene-referred light", "Y_ref"),
    ("pixels", "pixel", "x, y of the pixels that the truth knows"),
    ("speed", "pixel/s", "image speed at each event; 0 or NaN where unknown"),
    ("event_region", "1", "0 interior, 1 silhouette, 2 disoccluded, 3 shadow edge"),
    ("span_start", "1", "spans of pixel i are rows span_start[i] to span_start[i + 1]"),
    ("span_t_us", "us", "start of a span"),
    ("span_region", "1", "region of a span, as event_region"),
    ("provenance_json", "1", "where the truth comes from, JSON"),
];

/// Unit and description of the data set `name`.
fn known(name: &str) -> Option<(&'static str, &'static str)> {
    let times = [
        ("_t_other_us", "the other end of a flow's interval, or the start of an exposure"),
        ("_t_end_us", "the end of an exposure"),
        ("_t_us", "time of each image since the stream's start; of an exposure, its middle"),
    ];
    let exact = KNOWN.iter().find(|(known, ..)| *known == name).map(|&(_, unit, about)| (unit, about));
    exact.or_else(|| times.iter().find(|(end, _)| name.ends_with(end)).map(|&(_, about)| ("us", about)))
}

/// Writes the attributes of the data set `name`.
pub(super) fn describe(dataset: &H5Dataset, name: &str) -> Result<(), Hdf5Error> {
    let Some((unit, about)) = known(name) else {
        return Err(Hdf5Error::InvalidState(format!("the data set {name} has no description")));
    };
    for (attribute, value) in [("units", unit), ("description", about)] {
        // Of fixed length: strings of variable length take a heap of 4 KiB each.
        let kind = DatatypeMessage::fixed_string_utf8(value.len() as u32);
        dataset.set_attr_typed(attribute, kind, value.as_bytes().to_vec())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::LabelKind;

    #[test]
    fn every_label_and_its_times_have_a_unit() {
        for kind in LabelKind::ALL {
            assert!(known(kind.name()).is_some(), "{}", kind.name());
            assert_eq!(known(&format!("{}_t_us", kind.name())).unwrap().0, "us");
        }
        assert!(known("depth_t_other_us").unwrap().1.contains("other end"));
        assert_eq!(known("temperature"), None, "canary");
    }
}
