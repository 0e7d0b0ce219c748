// Numbers and times as people read them.

export function degrees(lat: number, lon: number): string {
  return `${lat.toFixed(6)}, ${lon.toFixed(6)}`;
}

/** "3.2 m", "12 m", "1.4 km": rounded up, for a radius may be said larger than it is and not smaller. */
export function radius(metres: number | null): string {
  if (metres === null) return "unknown";
  if (metres < 10) return `${(Math.ceil(metres * 10 - 1e-9) / 10).toFixed(1)} m`;
  if (metres < 1000) return `${Math.ceil(metres - 1e-9)} m`;
  return `${(Math.ceil(metres / 100) / 10).toFixed(1)} km`;
}

export function distance(metres: number): string {
  return metres < 1000 ? `${metres.toFixed(1)} m` : `${(metres / 1000).toFixed(3)} km`;
}

export function age(seconds: number | null): string {
  if (seconds === null) return "age unknown";
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (seconds < 120) return `${seconds.toFixed(0)} s`;
  return seconds < 7200 ? `${(seconds / 60).toFixed(0)} min` : `${(seconds / 3600).toFixed(1)} h`;
}

/** Time of day in UTC of Unix nanoseconds as a string. */
export function clock(unixNs: string): string {
  const ms = Number(BigInt(unixNs) / 1_000_000n);
  return `${new Date(ms).toISOString().slice(11, 21)} UTC`;
}

/** Latitude and longitude out of what somebody typed or pasted; null where it is none. */
export function parseCoordinate(text: string): { lat: number; lon: number } | null {
  const numbers = text.replace(/^geo:/i, "").split(/[\s,;]+/).filter((part) => part !== "").map(Number);
  const [lat, lon] = numbers;
  if (numbers.length < 2 || lat === undefined || lon === undefined || !numbers.every(Number.isFinite)) return null;
  return Math.abs(lat) <= 90 && Math.abs(lon) <= 180 ? { lat, lon } : null;
}
