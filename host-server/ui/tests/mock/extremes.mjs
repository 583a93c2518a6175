// What a point of the history has beside its means: as if a tenth less and more had been told too.

const scaled = (point, by) => ({
  range_mm: point.range_mm == null ? null : point.range_mm * by,
  battery_mv: point.battery_mv * by,
  battery_percent: Math.min(100, point.battery_percent * by),
  rssi_dbm: point.rssi_dbm == null ? null : point.rssi_dbm - 30 * (1 - by),
})

export const withExtremes = (point) => ({
  ...point,
  least: scaled(point, 0.9),
  most: scaled(point, 1.1),
})
