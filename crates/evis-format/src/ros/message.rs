//! The messages that are written, and their types: names, and definitions as `rosbag2` keeps them, with what they refer to.

use evis_core::CameraInfo;

use super::cdr::Cdr;

/// A type of messages.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct MessageType {
    pub name: &'static str,
    pub definition: &'static str,
}

macro_rules! part {
    ($name:literal, $fields:literal) => {
        concat!(
            "================================================================================\nMSG: ",
            $name,
            "\n",
            $fields
        )
    };
}

macro_rules! header {
    () => {
        concat!(
            part!("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n"),
            part!("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n")
        )
    };
}

macro_rules! vector {
    () => {
        part!("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n")
    };
}

macro_rules! quaternion {
    () => {
        part!("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n")
    };
}

/// From `event_camera_msgs`.
pub(super) const EVENT_PACKET: MessageType = MessageType {
    name: "event_camera_msgs/msg/EventPacket",
    definition: concat!(
        "std_msgs/Header header\nuint32 height\nuint32 width\nuint64 seq\nuint64 time_base\nstring encoding\n",
        "bool is_bigendian\nuint8[] events\n",
        header!()
    ),
};

pub(super) const CAMERA_INFO: MessageType = MessageType {
    name: "sensor_msgs/msg/CameraInfo",
    definition: concat!(
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\n",
        "float64[9] k\nfloat64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\n",
        "sensor_msgs/RegionOfInterest roi\n",
        part!(
            "sensor_msgs/RegionOfInterest",
            "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n"
        ),
        header!()
    ),
};

pub(super) const IMAGE: MessageType = MessageType {
    name: "sensor_msgs/msg/Image",
    definition: concat!(
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n",
        "uint8[] data\n",
        header!()
    ),
};

pub(super) const POSE: MessageType = MessageType {
    name: "geometry_msgs/msg/PoseStamped",
    definition: concat!(
        "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
        part!("geometry_msgs/Pose", "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"),
        part!("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n"),
        quaternion!(),
        header!()
    ),
};

pub(super) const IMU: MessageType = MessageType {
    name: "sensor_msgs/msg/Imu",
    definition: concat!(
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n",
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n",
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n",
        quaternion!(),
        vector!(),
        header!()
    ),
};

/// Pixels of an image, row-major, channels innermost, and their encoding's name.
pub(super) struct Pixels<'a> {
    pub size: (u32, u32),
    pub encoding: &'a str,
    pub bytes: &'a [u8],
}

/// An [`IMAGE`].
pub(super) fn image(t_us: i64, frame: &str, pixels: &Pixels<'_>) -> Vec<u8> {
    let (width, height) = pixels.size;
    let mut message = Cdr::stamped(t_us, frame, pixels.bytes.len());
    message.u32(height);
    message.u32(width);
    message.text(pixels.encoding);
    message.bool(false);
    message.u32((pixels.bytes.len() / (height as usize).max(1)) as u32);
    message.bytes(pixels.bytes);
    message.finish()
}

/// An [`IMU`] without an orientation: m/s^2 and rad/s, of unknown covariance.
pub(super) fn imu(t_us: i64, frame: &str, accelerometer: [f64; 3], gyroscope: [f64; 3]) -> Vec<u8> {
    let mut message = Cdr::stamped(t_us, frame, 320);
    message.f64s(&[0.0, 0.0, 0.0, 1.0]);
    // Minus one says that there is no orientation; zeros, that the covariance is not known.
    message.f64s(&[-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    message.f64s(&gyroscope);
    message.f64s(&[0.0; 9]);
    message.f64s(&accelerometer);
    message.f64s(&[0.0; 9]);
    message.finish()
}

/// A [`CAMERA_INFO`]. ROS has pixel centres at whole numbers, EVIS at +0.5.
pub(super) fn camera_info(t_us: i64, frame: &str, camera: &CameraInfo) -> Vec<u8> {
    let CameraInfo { fx, fy, .. } = *camera;
    let (cx, cy) = (camera.cx - 0.5, camera.cy - 0.5);
    let (model, coefficients) = match &camera.distortion {
        None => ("plumb_bob", vec![0.0; 5]),
        Some(lens) => {
            let (model, count) = match (lens.model.as_str(), lens.coefficients.len()) {
                ("fisheye", _) => ("equidistant", 4),
                (_, ..=5) => ("plumb_bob", 5),
                _ => ("rational_polynomial", 8),
            };
            let mut coefficients = lens.coefficients.clone();
            coefficients.resize(count, 0.0);
            (model, coefficients)
        }
    };
    let mut message = Cdr::stamped(t_us, frame, 400);
    message.u32(camera.height);
    message.u32(camera.width);
    message.text(model);
    message.u32(coefficients.len() as u32);
    message.f64s(&coefficients);
    message.f64s(&[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]);
    message.f64s(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    message.f64s(&[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]);
    // No binning, and the whole picture.
    for _ in 0..6 {
        message.u32(0);
    }
    message.bool(false);
    message.finish()
}

/// A [`POSE`]: metres and a unit quaternion (x, y, z, w).
pub(super) fn pose(t_us: i64, frame: &str, position: [f64; 3], rotation: [f64; 4]) -> Vec<u8> {
    let mut message = Cdr::stamped(t_us, frame, 64);
    message.f64s(&position);
    message.f64s(&rotation);
    message.finish()
}
