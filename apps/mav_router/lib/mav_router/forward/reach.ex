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
  alias MavRouter.Endpoints.Endpoint
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

  @type relation :: :own | :part | :listener | :vehicle | :station | :stranger

  @typedoc "Endpoints that bring a source's system, and those of vehicles that take it for their ground station."
  @type near :: %{own: MapSet.t(Endpoint.key()), stations: MapSet.t(Endpoint.key())}

  @doc """
  What the relations of a source on a link are worked out from, once for all receivers. `stations?`: with the stations,
  which the relations of a vehicle need anyway.
  """
  @spec near(Source.t(), Path.t(), Tables.t(), boolean) :: near
  def near(source, from, tables, stations? \\ false) do
    obeyed_by =
      if source.vehicle or stations?,
        do: GroundStations.obeyed_by(tables, from.networks, source.system),
        else: []

    %{
      own: brought(for(network <- from.networks, do: {network, source.system}), tables),
      stations: brought(obeyed_by, tables)
    }
  end

  defp brought(systems, tables),
    do: for(system <- systems, key <- Routes.endpoints(tables, system), into: MapSet.new(), do: key)

  @doc "How a source on a link is related to an endpoint on the side of vehicles."
  @spec relation(Source.t(), Path.t(), Path.t(), near) :: relation
  def relation(%{vehicle: vehicle?}, from, to, near) do
    own? = to.key in near.own

    cond do
      vehicle? and to.heard_vehicle != true and own? -> :own
      vehicle? and station?(to, near) -> :station
      vehicle? and to.heard_vehicle != true -> :listener
      vehicle? -> :vehicle
      own? and (from.parts or from.commands) -> :part
      true -> :stranger
    end
  end

  @doc "Whether a vehicle at an endpoint takes the system of a source for its ground station."
  @spec station?(Path.t(), near) :: boolean
  def station?(to, near), do: to.key in near.stations

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
