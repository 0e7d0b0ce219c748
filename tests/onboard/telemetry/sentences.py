"""NMEA sentences of a receiver that flies east, written for tests."""


def sentence(body: str) -> bytes:
    total = 0
    for byte in body.encode():
        total ^= byte
    return f"${body}*{total:02X}\r\n".encode()


def moment(t: float) -> str:
    """Seconds of a day -> hhmmss.ss."""
    t %= 86_400.0
    return f"{int(t) // 3600:02d}{int(t) // 60 % 60:02d}{t % 60.0:05.2f}"


def place(lat_deg: float, lon_deg: float) -> str:
    def part(value: float, width: int, names: str) -> str:
        size = abs(value)
        return f"{int(size):0{width}d}{(size % 1.0) * 60.0:08.5f},{names[value < 0.0]}"

    return f"{part(lat_deg, 2, 'NS')},{part(lon_deg, 3, 'EW')}"


def gga(t: float, lat: float, lon: float, quality: int = 1, height: str = "350.2", separation: str = "12.5") -> bytes:
    return sentence(f"GNGGA,{moment(t)},{place(lat, lon)},{quality},09,1.2,{height},M,{separation},M,,")


def rmc(t: float, lat: float, lon: float, status: str = "A", knots: str = "19.438", course: str = "90.0") -> bytes:
    return sentence(f"GNRMC,{moment(t)},{status},{place(lat, lon)},{knots},{course},230394,,,A")


def gst(t: float) -> bytes:
    return sentence(f"GNGST,{moment(t)},2.0,,,,0.8,0.6,1.5")


def vtg(knots: str = "19.438", course: str = "90.0") -> bytes:
    return sentence(f"GNVTG,{course},T,,M,{knots},N,36.0,K,A")


def burst(t: float, **more: int) -> bytes:
    """One epoch of a receiver at 10 m/s to the east, at its place of then."""
    lat, lon = -43.38, 172.4 + 10.0 * (t % 3600.0) / 80_917.0
    return rmc(t, lat, lon) + vtg() + gga(t, lat, lon, **more) + gst(t)
