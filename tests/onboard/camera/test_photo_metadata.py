"""What photographs of several makers say of themselves, each as its maker writes it (numbers made up)."""

import math
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational

from contract.rotations import matrix_from_euler
from onboard.camera.photo_metadata import PhotoMetadata, read_photo
from onboard.camera.rig_bands import one_band
from onboard.replay.photo_telemetry import datum_sigma_m, height_amsl

NAMESPACES = (
    'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" '
    'xmlns:Camera="http://pix4d.com/camera/1.0" xmlns:DLS="http://micasense.com/DLS/1.0/" '
    'xmlns:drone-parrot="http://www.parrot.com/drone-parrot/1.0/" '
    'xmlns:drone-skydio="https://www.skydio.com/drone-skydio/1.0/"'
)
GPS = ExifTags.GPS


def photo(
    tmp_path: Path,
    xmp: str = "",
    elements: str = "",
    make: str = "DJI",
    model: str = "FC7303",
    size: tuple[int, int] = (400, 300),
    details: dict[int, object] | None = None,
    name: str = "a.jpg",
) -> PhotoMetadata:
    exif = Image.Exif()
    exif[ExifTags.Base.Make], exif[ExifTags.Base.Model] = make, model
    exif._ifds[ExifTags.IFD.Exif] = {ExifTags.Base.DateTimeOriginal: "2024:06:01 09:00:00"} | (details or {})
    exif._ifds[ExifTags.IFD.GPSInfo] = {
        **{GPS.GPSLatitudeRef: "N", GPS.GPSLatitude: (IFDRational(48), IFDRational(6), IFDRational(0))},
        **{GPS.GPSLongitudeRef: "E", GPS.GPSLongitude: (IFDRational(11), IFDRational(30), IFDRational(0))},
        **{GPS.GPSAltitudeRef: b"\x00", GPS.GPSAltitude: IFDRational(600)},
    }
    packet = (
        f'<?xpacket begin=""?><x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF {NAMESPACES}>'
        f'<rdf:Description rdf:about="" {xmp}>{elements}</rdf:Description></rdf:RDF></x:xmpmeta><?xpacket end="w"?>'
    )
    path = tmp_path / name
    Image.new("L", size, 100).save(path, exif=exif, xmp=packet.encode())
    return read_photo(path)


# ---------------------------------------------------------------- heights

P4_RTK = 'drone-dji:AbsoluteAltitude="+650.00" drone-dji:RelativeAltitude="+60.0" drone-dji:RtkFlag="50"'
STD = 'drone-dji:RtkStdLat="0.011" drone-dji:RtkStdLon="0.012" drone-dji:RtkStdHgt="0.025"'


@pytest.mark.parametrize(
    ("xmp", "is_ellipsoidal"),
    [
        (f"{P4_RTK} {STD}", True),  # Phantom 4 RTK: no AltitudeType
        (f'{P4_RTK} {STD} drone-dji:AltitudeType="RtkAlt"', True),
        (P4_RTK, True),
        (f'{P4_RTK} {STD} drone-dji:AltitudeType="GpsFusionAlt"', False),
        ('drone-dji:AbsoluteAltitude="+650.00" drone-dji:RtkFlag="0"', False),
    ],
)
def test_heights_by_rtk_count_from_the_ellipsoid_also_where_nothing_says_so(
    tmp_path: Path, xmp: str, is_ellipsoidal: bool
) -> None:
    found = photo(tmp_path, xmp)
    assert found.height_is_ellipsoidal is is_ellipsoidal
    if is_ellipsoidal:
        # 47 m of undulation, as in southern Germany, lie within the sigma that is stated until it is known.
        height_m, own_m = height_amsl(found, None)
        datum_m = datum_sigma_m(found, None)
        assert height_m == 650.0 and datum_m is not None and 1.645 * math.hypot(own_m or 0.0, datum_m) > 47.0
        assert height_amsl(found, 47.0) == (603.0, found.sigma_vertical_m) and datum_sigma_m(found, 47.0) is None


def test_a_barometer_s_height_may_be_off_by_the_day_s_pressure(tmp_path: Path) -> None:
    found = photo(tmp_path, 'drone-dji:AbsoluteAltitude="-122.80" drone-dji:RelativeAltitude="+6.00"')
    assert found.height_is_barometric and not found.height_is_ellipsoidal
    datum_m = datum_sigma_m(found, None)
    assert 130.0 < 1.645 * datum_m < 200.0


def test_a_receiver_s_height_in_plain_exif_is_taken_as_before(tmp_path: Path) -> None:
    found = photo(tmp_path, make="Canon", model="SX260")
    assert height_amsl(found, None) == (600.0, 20.0) and datum_sigma_m(found, None) is None


# ---------------------------------------------------------------- focal lengths

# Full pictures' focal lengths by the equivalent, and that a 16:9 picture of the same width must have the same.
SHAPES = {
    "16:9 of 4:3 (Mini)": ("FC7303", (4000, 3000), (4000, 2250)),
    "16:9 of 3:2 (Air 2S)": ("FC3411", (5472, 3648), (5472, 3078)),
    "4:3 of 3:2 (Phantom 4 Pro)": ("FC6310", (5472, 3648), (4864, 3648)),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_a_cropped_picture_has_the_focal_length_of_the_whole(tmp_path: Path, shape: str) -> None:
    model, whole, part = SHAPES[shape]
    details = {ExifTags.Base.FocalLengthIn35mmFilm: 24}
    full = photo(tmp_path, model=model, size=(whole[0] // 4, whole[1] // 4), details=details).focal
    cropped = photo(tmp_path, model=model, size=(part[0] // 4, part[1] // 4), details=details).focal
    assert full.fx_px == pytest.approx(24.0 / 43.2666 * math.hypot(*whole) / 4, rel=1e-3)
    assert cropped.fx_px == pytest.approx(full.fx_px, rel=5e-3)
    assert 0.02 < full.sigma_px / full.fx_px < 0.04
    assert 0.05 < cropped.sigma_px / cropped.fx_px < 0.08  # eight per cent beyond the shape were seen


def test_a_picture_of_another_maker_in_its_sensor_s_shape_is_taken_as_before(tmp_path: Path) -> None:
    for size in ((400, 300), (600, 400)):
        details = {ExifTags.Base.FocalLengthIn35mmFilm: 30}
        focal = photo(tmp_path, make="Canon", model="EOS", size=size, details=details).focal
        assert focal.fx_px == pytest.approx(30.0 / 43.2666 * math.hypot(*size))


# ---------------------------------------------------------------- other makers

RED_EDGE_PLANE = {
    ExifTags.Base.FocalPlaneXResolution: IFDRational(266666667, 1000000),
    ExifTags.Base.FocalPlaneResolutionUnit: 4,
    ExifTags.Base.FocalLength: IFDRational(55, 10),
}
RED_EDGE = (
    "<Camera:ModelType>perspective</Camera:ModelType><Camera:BandName>Green</Camera:BandName>"
    "<Camera:RigCameraIndex>1</Camera:RigCameraIndex><Camera:PrincipalPoint>2.40,1.80</Camera:PrincipalPoint>"
    "<Camera:PerspectiveFocalLength>5.42</Camera:PerspectiveFocalLength>"
    "<Camera:PerspectiveFocalLengthUnits>mm</Camera:PerspectiveFocalLengthUnits>"
    "<Camera:PerspectiveDistortion><rdf:Seq><rdf:li>-0.10</rdf:li><rdf:li>0.14</rdf:li><rdf:li>-0.03</rdf:li>"
    "<rdf:li>0.001</rdf:li><rdf:li>-0.002</rdf:li></rdf:Seq></Camera:PerspectiveDistortion>"
    "<Camera:GPSXYAccuracy>1.8</Camera:GPSXYAccuracy><Camera:GPSZAccuracy>3.1</Camera:GPSZAccuracy>"
    "<Camera:VertCS>ellipsoidal</Camera:VertCS><DLS:Yaw>2.9</DLS:Yaw><DLS:Pitch>0.5</DLS:Pitch><DLS:Roll>0.1</DLS:Roll>"
    "<Camera:Yaw>40.0</Camera:Yaw><Camera:Pitch>5.0</Camera:Pitch><Camera:Roll>-3.0</Camera:Roll>"
)


def test_a_micasense_s_lens_accuracy_and_datum_are_read(tmp_path: Path) -> None:
    found = photo(
        tmp_path, elements=RED_EDGE, make="MicaSense", model="RedEdge", size=(1280, 960), details=RED_EDGE_PLANE
    )
    focal = found.focal
    assert focal.source == "PerspectiveFocalLength"
    assert focal.fx_px == pytest.approx(5.42 * 266.667, rel=1e-5) and focal.sigma_px < 0.005 * focal.fx_px
    assert focal.centre_px == pytest.approx((639.5, 479.5), abs=0.01)
    assert focal.distortion == (-0.10, 0.14, 0.001, -0.002, -0.03)  # k1, k2, p1, p2, k3
    assert (found.sigma_horizontal_m, found.sigma_vertical_m) == (1.8, 3.1)
    assert found.height_is_ellipsoidal and found.band == (1, "Green")


def test_pix4d_s_angles_count_from_looking_down(tmp_path: Path) -> None:
    """Not the light sensor's, which has the same names."""
    found = photo(tmp_path, elements=RED_EDGE, make="MicaSense", model="RedEdge")
    assert found.gimbal_deg is not None
    roll, pitch, yaw = np.radians(found.gimbal_deg)
    axis = matrix_from_euler(roll, pitch, yaw)[:, 0]  # the optical axis, north-east-down
    expected = matrix_from_euler(*np.radians([-3.0, 5.0, 40.0])) @ np.array([0.0, 0.0, 1.0])
    assert axis == pytest.approx(expected, abs=1e-9)
    top = -matrix_from_euler(roll, pitch, yaw)[:, 2]  # the picture's top, towards the nose
    assert top == pytest.approx(matrix_from_euler(*np.radians([-3.0, 5.0, 40.0]))[:, 0], abs=1e-9)


@pytest.mark.parametrize("yaw", [0.0, 40.0, -170.0])
def test_exactly_down_keeps_its_heading(tmp_path: Path, yaw: float) -> None:
    found = photo(tmp_path, f'Camera:Yaw="{yaw}" Camera:Pitch="0" Camera:Roll="0"', make="Sentera", model="6X")
    assert found.gimbal_deg is not None
    R = matrix_from_euler(*np.radians(found.gimbal_deg))
    assert R[:, 0] == pytest.approx((0.0, 0.0, 1.0), abs=1e-9)
    assert math.degrees(math.atan2(-R[1, 2], -R[0, 2])) == pytest.approx(yaw, abs=1e-6)


def test_a_parrot_s_names_of_angles_are_read(tmp_path: Path) -> None:
    found = photo(
        tmp_path,
        'drone-parrot:CameraRollDegree="0.5" drone-parrot:CameraPitchDegree="-88.0" '
        'drone-parrot:CameraYawDegree="120.0" drone-parrot:DroneRollDegree="1" '
        'drone-parrot:DronePitchDegree="-4" drone-parrot:DroneYawDegree="119"',
        make="Parrot",
        model="Anafi",
    )
    assert found.gimbal_deg == (0.5, -88.0, 120.0) and found.body_deg == (1.0, -4.0, 119.0)


SKYDIO = (
    '<drone-skydio:CameraOrientationNED rdf:parseType="Resource"><drone-skydio:Roll>0.5</drone-skydio:Roll>'
    "<drone-skydio:Pitch>-89.0</drone-skydio:Pitch><drone-skydio:Yaw>33.0</drone-skydio:Yaw>"
    "</drone-skydio:CameraOrientationNED>"
    '<drone-skydio:CameraOrientationFLU rdf:parseType="Resource"><drone-skydio:Roll>9</drone-skydio:Roll>'
    "<drone-skydio:Pitch>9</drone-skydio:Pitch><drone-skydio:Yaw>9</drone-skydio:Yaw></drone-skydio:CameraOrientationFLU>"
    '<drone-skydio:CalibratedFocalLength drone-skydio:X="2376.5" drone-skydio:Y="2377.5"/>'
    '<drone-skydio:CalibratedOpticalCenter drone-skydio:X="2030.5" drone-skydio:Y="1519.5"/>'
    "<drone-skydio:DewarpData>0.13, -0.24, 0.104</drone-skydio:DewarpData>"
    "<drone-skydio:AbsoluteAltitude>650.0</drone-skydio:AbsoluteAltitude>"
    "<drone-skydio:GpsHorizontalAccuracy>0.9</drone-skydio:GpsHorizontalAccuracy>"
)


def test_a_skydio_s_structures_calibration_and_ellipsoidal_height_are_read(tmp_path: Path) -> None:
    found = photo(tmp_path, elements=SKYDIO, make="Skydio", model="2", size=(4056, 3040))
    assert found.gimbal_deg == (0.5, -89.0, 33.0) and found.height_is_ellipsoidal
    assert found.sigma_horizontal_m == 0.9
    focal = found.focal
    assert (focal.fx_px, focal.fy_px) == (2376.5, 2377.5)
    assert focal.centre_px == (2030.5, 1519.5) and focal.distortion == (0.13, -0.24, 0.0, 0.0, 0.104)


def test_a_skydio_s_digital_zoom_is_in_exif(tmp_path: Path) -> None:
    details = {ExifTags.Base.DigitalZoomRatio: IFDRational(2)}
    focal = photo(tmp_path, elements=SKYDIO, make="Skydio", model="2", size=(4056, 3040), details=details).focal
    assert focal.fx_px == 2 * 2376.5 and focal.centre_px == pytest.approx((2033.5, 1519.5))


@pytest.mark.parametrize("line", ["15500", "15.5", "0.0155", "0.0000155"])
def test_a_line_s_readout_time_is_a_picture_s_in_whatever_unit(tmp_path: Path, line: str) -> None:
    found = photo(tmp_path, f'Camera:LineReadoutTime="{line}"', make="Parrot", size=(400, 3000))
    assert found.readout_s == pytest.approx(0.0465)


def test_a_fisheye_has_no_focal_length_of_ours(tmp_path: Path) -> None:
    details = {ExifTags.Base.FocalLengthIn35mmFilm: 24}
    assert photo(tmp_path, 'Camera:ModelType="fisheye"', make="Parrot", details=details).focal is None


def test_the_cameras_of_dji_s_payload_are_a_rig_of_which_the_wide_one_is_taken(tmp_path: Path) -> None:
    photos = [
        photo(tmp_path, f'drone-dji:ImageSource="{source}"', make="DJI", name=f"DJI_{shot:04d}_{source[0]}.jpg")
        for shot in range(3)
        for source in ("InfraredCamera", "WideCamera", "ZoomCamera")
    ]
    kept, text = one_band(photos)
    assert [p.name for p in kept] == [f"DJI_{shot:04d}_W.jpg" for shot in range(3)]
    assert text == "WideCamera, camera 0 of a rig of 3; the others' 6 left out"
    thermal = [p for p in photos if p.name.endswith("_I.jpg")]
    assert one_band(thermal) == (thermal, "")


def test_the_bands_of_a_rig_are_several_cameras(tmp_path: Path) -> None:
    photos = [
        photo(
            tmp_path,
            f'Camera:RigCameraIndex="{index}" Camera:BandName="{band}"',
            make="MicaSense",
            name=f"IMG_{shot:04d}_{index + 1}.jpg",
        )
        for shot in range(3)
        for index, band in enumerate(("Blue", "Green", "Red"))
    ]
    kept, text = one_band(photos[1:])  # the first blue one is lost
    assert [p.name for p in kept] == [f"IMG_{shot:04d}_2.jpg" for shot in range(3)]
    assert text == "Green, camera 1 of a rig of 3; the others' 5 left out"
    alone = [photo(tmp_path, name=f"{i}.jpg") for i in range(3)]
    assert one_band(alone) == (alone, "")
