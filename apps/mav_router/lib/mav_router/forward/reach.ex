defmodule MavRouter.Forward.Reach do
  @moduledoc """
  What vehicles, their parts and strangers reach on the side of vehicles: everything is refused that the table
  (`MavCodec.Meaning.Messages`) does not list. Frames of clients are judged by `MavRouter.Forward.Gate` instead; clients
  hear everything.

  | relation of the sender to the receiver | gets through |
  |---|---|
  | `:own`: an autopilot, to an endpoint of its own parts | everything |
  | `:part`: a part, to its autopilot, by a link with `parts: true` or from this machine | rows with `part` |
  | `:listener`: a vehicle, to an endpoint that has not said what it is | telemetry, questions and answers; what has a ground station's id as its target |
  | `:vehicle`: a vehicle, to another one | rows with `crosses` |
  | `:station`: a vehicle, to another one that takes its id for its ground station's | the same without heartbeats |
  | `:stranger`: anybody else | nothing |
  """

  import MavCodec.Meaning.Heartbeat, only: [is_station: 1]

  alias MavCodec.Meaning.Messages
  alias MavCodec.Meaning.Heartbeat
  alias MavCodec.MessageId
  alias MavRouter.Forward.GroundStations
  alias MavRouter.Forward.Table.Path
  alias MavRouter.Routes
  alias MavRouter.Forward.Source
  alias MavRouter.Tables
  alias MavCodec.Frame

  @command_ack MessageId.of!("COMMAND_ACK")
  @heartbeat Heartbeat.id()
  @authorization MavCodec.Enums.MavCmd.value(:MAV_CMD_ARM_AUTHORIZATION_REQUEST)
  @heard [:telemetry, :presence, :question, :answer]
  @few 16

  @type relation :: :own | :part | :listener | :vehicle | :station | :stranger

  @doc "How a source on a link is related to an endpoint of vehicles; `own?`: that one brings its system as well."
  @spec relation(Source.t(), Path.t(), Path.t(), boolean, Tables.t()) :: relation
  def relation(%{vehicle: vehicle?} = source, from, to, own?, tables) do
    cond do
      vehicle? and to.heard_vehicle != true and own? -> :own
      vehicle? and station?(source, from, to, tables) -> :station
      vehicle? and to.heard_vehicle != true -> :listener
      vehicle? -> :vehicle
      own? and (from.parts or from.commands) -> :part
      true -> :stranger
    end
  end

  @doc "Whether a vehicle at an endpoint takes the system of a source for its ground station."
  @spec station?(Source.t(), Path.t(), Path.t(), Tables.t()) :: boolean
  def station?(%{system: system}, %{networks: networks}, to, tables) do
    # There may be hundreds of vehicles, or of systems behind an endpoint; hardly ever both.
    vehicles =
      with :many <- Routes.heard_by(tables, to.key, @few),
           do: GroundStations.obeyed_by(tables, networks, system)

    Enum.any?(vehicles, fn {network, _system} = vehicle ->
      network in networks and GroundStations.obeys?(tables, vehicle, system) and
        Routes.on_endpoint?(tables, vehicle, to.key)
    end)
  end

  @doc "Whether a frame gets through. `between` is `router.between_vehicles`."
  @spec passes?(relation, Frame.t(), between :: atom) :: boolean
  def passes?(:own, _frame, _between), do: true
  def passes?(:stranger, _frame, _between), do: false

  def passes?(relation, frame, between) do
    case Messages.row(frame.id) do
      nil -> false
      row -> listed?(relation, row, frame, between)
    end
  end

  # Its failsafe would stay quiet.
  defp listed?(:station, _row, %{id: @heartbeat}, _between), do: false
  defp listed?(:station, row, frame, between), do: listed?(:vehicle, row, frame, between)

  # It may be a vehicle that has not spoken yet.
  defp listed?(:listener, _row, %{id: @heartbeat} = frame, _between), do: not Heartbeat.station?(frame)

  # A vehicle could take RC_CHANNELS of another one for its pilot's sticks before its own first heartbeat.
  defp listed?(:listener, %{class: class, permission: permission}, frame, _between),
    do: (class in @heard and permission != :manual) or for_station?(Frame.target(frame))

  defp listed?(:part, %{part: part?}, %{id: @heartbeat} = frame, _between),
    do: part? and not Heartbeat.station?(frame)

  # Parts of a vehicle do not decide whether it may arm.
  defp listed?(:part, _row, %{id: @command_ack} = frame, _between), do: not authorizes?(frame)
  defp listed?(:part, %{part: part?}, _frame, _between), do: part?

  defp listed?(:vehicle, %{crosses: :always}, frame, _between), do: not Heartbeat.station?(frame)
  defp listed?(:vehicle, %{crosses: crosses}, _frame, between), do: crosses == :team and between == :all

  defp for_station?({system, _component}) when is_station(system), do: true
  defp for_station?(_other), do: false

  defp authorizes?(%{payload: payload}),
    do: match?(<<@authorization::16-little, _::binary>>, <<payload::binary, 0::16>>)
end
