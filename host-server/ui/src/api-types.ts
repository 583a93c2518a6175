/** The server's own types, by the names that the control room uses. */

import type { components } from './.generated/interface'

type Schemas = components['schemas']

export type RobotBody = Schemas['Robot']
export type RobotsBody = Schemas['Robots']
export type CommandRecord = Schemas['CommandRecord']
export type CommandOutcome = Schemas['CommandOutcome']
export type OutcomeStatus = CommandOutcome['status']
export type CommandRecords = Schemas['CommandRecords']
export type TelemetryHistory = Schemas['TelemetryHistory']
export type TelemetryPoint = Schemas['TelemetryPoint']
export type ParametersBody = Schemas['Parameters']
export type SimulatorBody = Schemas['Simulator']
export type SimulatorAnswer = Schemas['SimulatorAnswer']
export type LogRecord = Schemas['LogRecordMessage']
export type SimulatorCommand = Schemas['SimulatorCommandMessage']
export type CommandRequest = Schemas['CommandRequestMessage']
