/** The server's own types, by the names that the control room uses. */

import type { components } from './.generated/interface'

type Schemas = components['schemas']

export type RobotBody = Schemas['Robot']
export type RobotsBody = Schemas['Robots']
export type CommandRecord = Schemas['CommandRecord']
export type CommandOutcome = Schemas['CommandOutcome']
export type OutcomeStatus = CommandOutcome['status']
export type TelemetryHistory = Schemas['TelemetryHistory']
export type TelemetryPoint = Schemas['TelemetryPoint']
export type ParametersBody = Schemas['Parameters']
export type SimulatorBody = Schemas['Simulator']
export type SimulatorAnswer = Schemas['SimulatorAnswer']
export type DroppedItem = Schemas['DroppedItem']
export type Bookmark = Schemas['Bookmark']
export type Scenarios = Schemas['Scenarios']
export type ScenarioSummary = Schemas['ScenarioSummary']
export type ScenarioPreview = Schemas['ScenarioPreview']
export type LogRecord = Schemas['LogRecordMessage']
export type SimulatorCommand = Schemas['SimulatorCommand']
export type CommandRequest = Schemas['CommandRequest']
export type FenceBody = Schemas['Fence']
export type NewFence = Schemas['NewFence']
export type NewUser = Schemas['NewUser']
export type NewCredential = Schemas['NewCredential']
export type Ticket = Schemas['Ticket']
export type AuditVerdict = Schemas['AuditVerdict']

export type NewExperiment = Schemas['NewExperiment']
export type Experiment = Schemas['Experiment']
export type ExperimentSummary = Experiment['summary'][number]
export type ExperimentMetrics = Schemas['ExperimentMetrics']
export type ExperimentMetric = ExperimentMetrics['metrics'][number]
/** `command`: what to type to see it again, where the server says it. */
export type ExperimentTrial = ExperimentMetrics['trials'][number] & { command?: string | null }
export type HistorySpan = Schemas['HistorySpan']
export type HistoryFrames = Schemas['HistoryFrames']
export type EventsBody = Schemas['Events']
export type RecordedEvent = EventsBody['events'][number]
