/** Words of behaviours that need more than their name. */
export const missions = {
  title: 'Missions',
  leader: 'Leader',
  distance: 'Distance in metres',
  follow: 'Follow',
  following: (id: string) => `Follow ${id}`,
  waypoints: 'Places',
  example: '0 0; 2 0; 2 2',
  laps: 'Laps, 0 for ever',
  patrol: 'Patrol',
  tasks: 'Tasks',
  allocate: 'Share out',
  value: 'Number, temperature or range',
  liars: 'Liars to bear',
  consensus: 'Agree',
  badValue: 'What to agree on is a number within ±1,000,000, temperature, or range.',
  badLiars: 'Liars must be a whole number from 0 to 7.',
  badLeader: 'The leader is the id of a robot: a-z, 0-9 and -, at most 32 characters.',
  badDistance: 'The distance must be a number from 0.25 to 2 m.',
  badPlaces: (least: number) =>
    `Give ${String(least)} to 8 places as x and y in metres within ±1000, with a semicolon between two: 0 0; 2 0.`,
  badLaps: 'Laps must be a whole number from 0 to 1000.',
}
