/** Calls of the pages about robots, commands and the simulated world. */

import type {
  CommandRecord,
  LogRecord,
  ParametersBody,
  ScenarioPreview,
  ScenarioSummary,
  SimulatorAnswer,
  SimulatorBody,
  SimulatorCommand,
  TelemetryHistory,
} from '../api-types'
import type { Command } from '../api'
import { asRequest } from '../api'
import { createClient } from '../client'
import type { Send } from '../http'

export type Parameter = ParametersBody['parameters'][number]
type ParameterValue = number | string | boolean
export type FaultSpec = Extract<SimulatorCommand, { command: 'inject' }>['fault']

interface Span {
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
  const ask = createClient(send)

  return {
    async parameters(id) {
      return (await ask('get', '/robots/{id}/parameters', { path: { id } })).parameters
    },
    setParameters: (id, values) =>
      ask('put', '/robots/{id}/parameters', { path: { id }, body: values }),
    async logs(id) {
      const { records } = await ask('get', '/robots/{id}/logs', { path: { id } })
      // Messages of robots, whose type the description of the interface leaves open.
      return records as unknown as LogRecord[]
    },
    history: (id, { from, to, step }) =>
      ask('get', '/robots/{id}/telemetry', { path: { id }, query: { from, to, step } }),
    async commands(robot, limit) {
      return (await ask('get', '/commands', { query: { limit, robot } })).commands
    },
    command: (id) => ask('get', '/commands/{id}', { path: { id } }),
    toRobot: (id, command) =>
      ask('post', '/robots/{id}/commands', { path: { id }, body: asRequest(command) }),
    toSwarm: (command) => ask('post', '/swarm/commands', { body: asRequest(command) }),
    simulator: () => ask('get', '/simulator'),
    simulate: (command) => ask('post', '/simulator/commands', { body: command }),
    async scenarios() {
      return (await ask('get', '/simulator/scenarios')).scenarios
    },
    scenario: (name, robots, seed) =>
      ask('get', '/simulator/scenarios/{name}', { path: { name }, query: { robots, seed } }),
    async inject(id, fault, lasting) {
      const body = lasting === null ? { fault } : { fault, lasting_ms: lasting }
      await ask('post', '/robots/{id}/faults', { path: { id }, body })
    },
    async heal(id) {
      await ask('delete', '/robots/{id}/faults', { path: { id } })
    },
  }
}
