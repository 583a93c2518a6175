/** Calls of the pages about robots, commands and the simulated world. */

import type {
  CommandRecord,
  CommandRecords,
  LogRecord,
  ParametersBody,
  ScenarioPreview,
  ScenarioSummary,
  Scenarios,
  SimulatorAnswer,
  SimulatorBody,
  SimulatorCommand,
  TelemetryHistory,
} from '../api-types'
import type { Command } from '../api'
import type { Send } from '../http'
import { SLOW_MS, call } from '../http'

export type Parameter = ParametersBody['parameters'][number]
export type ParameterValue = number | string | boolean
export type FaultSpec = Extract<SimulatorCommand, { command: 'inject' }>['fault']

export interface Span {
  from: number
  to: number
  step: number
}

export interface FleetApi {
  parameters(robot: string): Promise<readonly Parameter[]>
  setParameters(robot: string, values: Record<string, ParameterValue>): Promise<CommandRecord>
  logs(robot: string): Promise<readonly LogRecord[]>
  history(robot: string, span: Span): Promise<TelemetryHistory>
  /** The newest first; with a robot those that went to it, and its outcome. */
  commands(robot: string | null, limit: number): Promise<readonly CommandRecord[]>
  command(id: string): Promise<CommandRecord>
  toRobot(robot: string, command: Command): Promise<CommandRecord>
  toSwarm(command: Command): Promise<CommandRecord>
  simulator(): Promise<SimulatorBody>
  simulate(command: SimulatorCommand): Promise<SimulatorAnswer>
  scenarios(): Promise<readonly ScenarioSummary[]>
  /** How a scenario begins; `null` leaves seed and number of robots to the scenario. */
  scenario(name: string, robots: number | null, seed: number | null): Promise<ScenarioPreview>
  inject(robot: string, fault: FaultSpec, lasting: number | null): Promise<void>
  heal(robot: string): Promise<void>
}

export function fleetApi(send: Send): FleetApi {
  // The server's answers are what it says they are: a test on its side holds it to that.
  const ask = async <T>(method: string, path: string, body?: unknown): Promise<T> =>
    (await call(send, method, path, body, SLOW_MS)) as T
  const of = (robot: string): string => `/robots/${encodeURIComponent(robot)}`

  return {
    async parameters(robot) {
      return (await ask<ParametersBody>('GET', `${of(robot)}/parameters`)).parameters
    },
    setParameters: (robot, values) => ask('PUT', `${of(robot)}/parameters`, values),
    async logs(robot) {
      return (await ask<{ records: LogRecord[] }>('GET', `${of(robot)}/logs`)).records
    },
    history: (robot, { from, to, step }) =>
      ask(
        'GET',
        `${of(robot)}/telemetry?from=${String(from)}&to=${String(to)}&step=${String(step)}`,
      ),
    async commands(robot, limit) {
      const which = robot === null ? '' : `&robot=${encodeURIComponent(robot)}`
      return (await ask<CommandRecords>('GET', `/commands?limit=${String(limit)}${which}`)).commands
    },
    command: (id) => ask('GET', `/commands/${encodeURIComponent(id)}`),
    toRobot: (robot, command) => ask('POST', `${of(robot)}/commands`, command),
    toSwarm: (command) => ask('POST', '/swarm/commands', command),
    simulator: () => ask('GET', '/simulator'),
    simulate: (command) => ask('POST', '/simulator/commands', command),
    async scenarios() {
      return (await ask<Scenarios>('GET', '/simulator/scenarios')).scenarios
    },
    scenario(name, robots, seed) {
      const query = new URLSearchParams()
      if (robots !== null) query.set('robots', String(robots))
      if (seed !== null) query.set('seed', String(seed))
      const asked = query.size === 0 ? '' : `?${query.toString()}`
      return ask('GET', `/simulator/scenarios/${encodeURIComponent(name)}${asked}`)
    },
    async inject(robot, fault, lasting) {
      const body = lasting === null ? { fault } : { fault, lasting_ms: lasting }
      await ask('POST', `${of(robot)}/faults`, body)
    },
    async heal(robot) {
      await ask('DELETE', `${of(robot)}/faults`)
    },
  }
}
