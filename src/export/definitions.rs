//! Definitions of the messages of ROS 2 and Foxglove that are written here: field by field as in `common_interfaces`, `geometry2` and `rcl_interfaces` of ROS 2 Humble,
//! and in `foxglove_msgs`, without their comments.

/// Between two definitions: 80 times `=`, as rosbag2 has it.
const RULE: &str = "================================================================================";

/// Each definition with the definitions that it uses. The order is that of the alphabet.
const DEFINITIONS: [(&str, &str, &[&str]); 33] = [
    ("builtin_interfaces/Duration", "int32 sec\nuint32 nanosec\n", &[]),
    ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n", &[]),
    (
        "foxglove_msgs/ArrowPrimitive",
        "geometry_msgs/Pose pose\nfloat64 shaft_length\nfloat64 shaft_diameter\nfloat64 head_length\nfloat64 head_diameter\nfoxglove_msgs/Color color\n",
        &["foxglove_msgs/Color", "geometry_msgs/Pose"],
    ),
    (
        "foxglove_msgs/CircleAnnotation",
        "builtin_interfaces/Time timestamp\nfoxglove_msgs/Point2 position\nfloat64 diameter\nfloat64 thickness\nfoxglove_msgs/Color fill_color\nfoxglove_msgs/Color outline_color\n",
        &["builtin_interfaces/Time", "foxglove_msgs/Color", "foxglove_msgs/Point2"],
    ),
    ("foxglove_msgs/Color", "float64 r\nfloat64 g\nfloat64 b\nfloat64 a\n", &[]),
    (
        "foxglove_msgs/CubePrimitive",
        "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 size\nfoxglove_msgs/Color color\n",
        &["foxglove_msgs/Color", "geometry_msgs/Pose", "geometry_msgs/Vector3"],
    ),
    (
        "foxglove_msgs/CylinderPrimitive",
        "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 size\nfloat64 bottom_scale\nfloat64 top_scale\nfoxglove_msgs/Color color\n",
        &["foxglove_msgs/Color", "geometry_msgs/Pose", "geometry_msgs/Vector3"],
    ),
    (
        "foxglove_msgs/ImageAnnotations",
        "foxglove_msgs/CircleAnnotation[] circles\nfoxglove_msgs/PointsAnnotation[] points\nfoxglove_msgs/TextAnnotation[] texts\n",
        &["foxglove_msgs/CircleAnnotation", "foxglove_msgs/PointsAnnotation", "foxglove_msgs/TextAnnotation"],
    ),
    ("foxglove_msgs/KeyValuePair", "string key\nstring value\n", &[]),
    (
        "foxglove_msgs/LinePrimitive",
        "uint8 LINE_STRIP=0\nuint8 LINE_LOOP=1\nuint8 LINE_LIST=2\nuint8 type\ngeometry_msgs/Pose pose\nfloat64 thickness\nbool scale_invariant\ngeometry_msgs/Point[] points\nfoxglove_msgs/Color color\nfoxglove_msgs/Color[] colors\nuint32[] indices\n",
        &["foxglove_msgs/Color", "geometry_msgs/Point", "geometry_msgs/Pose"],
    ),
    (
        "foxglove_msgs/ModelPrimitive",
        "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nfoxglove_msgs/Color color\nbool override_color\nstring url\nstring media_type\nuint8[] data\n",
        &["foxglove_msgs/Color", "geometry_msgs/Pose", "geometry_msgs/Vector3"],
    ),
    ("foxglove_msgs/Point2", "float64 x\nfloat64 y\n", &[]),
    (
        "foxglove_msgs/PointsAnnotation",
        "builtin_interfaces/Time timestamp\nuint8 UNKNOWN=0\nuint8 POINTS=1\nuint8 LINE_LOOP=2\nuint8 LINE_STRIP=3\nuint8 LINE_LIST=4\nuint8 type\nfoxglove_msgs/Point2[] points\nfoxglove_msgs/Color outline_color\nfoxglove_msgs/Color[] outline_colors\nfoxglove_msgs/Color fill_color\nfloat64 thickness\n",
        &["builtin_interfaces/Time", "foxglove_msgs/Color", "foxglove_msgs/Point2"],
    ),
    (
        "foxglove_msgs/SceneEntity",
        "builtin_interfaces/Time timestamp\nstring frame_id\nstring id\nbuiltin_interfaces/Duration lifetime\nbool frame_locked\nfoxglove_msgs/KeyValuePair[] metadata\nfoxglove_msgs/ArrowPrimitive[] arrows\nfoxglove_msgs/CubePrimitive[] cubes\nfoxglove_msgs/SpherePrimitive[] spheres\nfoxglove_msgs/CylinderPrimitive[] cylinders\nfoxglove_msgs/LinePrimitive[] lines\nfoxglove_msgs/TriangleListPrimitive[] triangles\nfoxglove_msgs/TextPrimitive[] texts\nfoxglove_msgs/ModelPrimitive[] models\n",
        &[
            "builtin_interfaces/Duration",
            "builtin_interfaces/Time",
            "foxglove_msgs/ArrowPrimitive",
            "foxglove_msgs/CubePrimitive",
            "foxglove_msgs/CylinderPrimitive",
            "foxglove_msgs/KeyValuePair",
            "foxglove_msgs/LinePrimitive",
            "foxglove_msgs/ModelPrimitive",
            "foxglove_msgs/SpherePrimitive",
            "foxglove_msgs/TextPrimitive",
            "foxglove_msgs/TriangleListPrimitive",
        ],
    ),
    (
        "foxglove_msgs/SceneEntityDeletion",
        "builtin_interfaces/Time timestamp\nuint8 MATCHING_ID=0\nuint8 ALL=1\nuint8 type\nstring id\n",
        &["builtin_interfaces/Time"],
    ),
    (
        "foxglove_msgs/SceneUpdate",
        "foxglove_msgs/SceneEntityDeletion[] deletions\nfoxglove_msgs/SceneEntity[] entities\n",
        &["foxglove_msgs/SceneEntity", "foxglove_msgs/SceneEntityDeletion"],
    ),
    (
        "foxglove_msgs/SpherePrimitive",
        "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 size\nfoxglove_msgs/Color color\n",
        &["foxglove_msgs/Color", "geometry_msgs/Pose", "geometry_msgs/Vector3"],
    ),
    (
        "foxglove_msgs/TextAnnotation",
        "builtin_interfaces/Time timestamp\nfoxglove_msgs/Point2 position\nstring text\nfloat64 font_size\nfoxglove_msgs/Color text_color\nfoxglove_msgs/Color background_color\n",
        &["builtin_interfaces/Time", "foxglove_msgs/Color", "foxglove_msgs/Point2"],
    ),
    (
        "foxglove_msgs/TextPrimitive",
        "geometry_msgs/Pose pose\nbool billboard\nfloat64 font_size\nbool scale_invariant\nfoxglove_msgs/Color color\nstring text\n",
        &["foxglove_msgs/Color", "geometry_msgs/Pose"],
    ),
    (
        "foxglove_msgs/TriangleListPrimitive",
        "geometry_msgs/Pose pose\ngeometry_msgs/Point[] points\nfoxglove_msgs/Color color\nfoxglove_msgs/Color[] colors\nuint32[] indices\n",
        &["foxglove_msgs/Color", "geometry_msgs/Point", "geometry_msgs/Pose"],
    ),
    ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n", &[]),
    (
        "geometry_msgs/Pose",
        "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
        &["geometry_msgs/Point", "geometry_msgs/Quaternion"],
    ),
    ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n", &[]),
    (
        "geometry_msgs/Transform",
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
        &["geometry_msgs/Quaternion", "geometry_msgs/Vector3"],
    ),
    (
        "geometry_msgs/TransformStamped",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
        &["geometry_msgs/Transform", "std_msgs/Header"],
    ),
    ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n", &[]),
    (
        "rcl_interfaces/Log",
        "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\nbuiltin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\nuint32 line\n",
        &["builtin_interfaces/Time"],
    ),
    (
        "sensor_msgs/CameraInfo",
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi\n",
        &["sensor_msgs/RegionOfInterest", "std_msgs/Header"],
    ),
    (
        "sensor_msgs/CompressedImage",
        "std_msgs/Header header\nstring format\nuint8[] data\n",
        &["std_msgs/Header"],
    ),
    (
        "sensor_msgs/JointState",
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
        &["std_msgs/Header"],
    ),
    (
        "sensor_msgs/RegionOfInterest",
        "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n",
        &[],
    ),
    ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n", &["builtin_interfaces/Time"]),
    (
        "tf2_msgs/TFMessage",
        "geometry_msgs/TransformStamped[] transforms\n",
        &["geometry_msgs/TransformStamped"],
    ),
];

/// The name of a definition as MCAP has it for ROS 2: `PACKAGE/msg/NAME`.
pub(super) fn full_name(name: &str) -> String {
    name.replacen('/', "/msg/", 1)
}

/// A definition, with those that it uses behind it, each once.
pub(super) fn definition(name: &str) -> String {
    let find = |name: &str| DEFINITIONS.iter().find(|(known, ..)| *known == name);
    let Some((_, text, uses)) = find(name) else { return String::new() };
    let mut text = (*text).to_owned();
    let (mut told, mut next) = (Vec::new(), uses.to_vec());
    while let Some(inner) = next.pop() {
        if told.contains(&inner) {
            continue;
        }
        told.push(inner);
        if let Some((_, fields, uses)) = find(inner) {
            text += &format!("{RULE}\nMSG: {inner}\n{fields}");
            next.extend(*uses);
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_definition_is_complete() {
        for (name, ..) in DEFINITIONS {
            let text = definition(name);
            let types = text.lines().filter(|line| !line.starts_with("MSG: ")).filter_map(|line| {
                let word = line.split([' ', '[']).next()?;
                word.contains('/').then_some(word)
            });
            for used in types {
                assert_eq!(text.matches(&format!("MSG: {used}\n")).count(), 1, "{name}: {used}");
            }
        }
        assert_eq!(full_name("tf2_msgs/TFMessage"), "tf2_msgs/msg/TFMessage");
    }
}
