defmodule Aerie.Router.CommandGate do
  @moduledoc """
  Which endpoints may command vehicles: what of `Aerie.Router.ControlMessages` goes from an endpoint to the vehicles behind
  others.

  A **client** (`clients`, WebSockets, unix sockets) may: opening it was the operator's decision. For the endpoints of a **link** its `gcs`
  decides:

  | `gcs` | |
  |---|---|
  | `:auto` (default) | only endpoints with a loopback address, which this machine itself sends from |
  | `:allow` | everybody who reaches the link may command |
  | `:deny` | nobody may, not even this machine |

  From an endpoint that may not command,

  - commands reach no vehicle, whatever their target, and whether their sender is a ground station that called the link, says
    nothing of itself, or says that it is a vehicle. They are counted as `denied` and told in the log once a minute for each
    link. A COMMAND_LONG or COMMAND_INT is answered with DENIED, once a second for each link: so a lost answer costs nothing, and
    an invented sender gains nothing (the answer is shorter than the command).
  - input of estimators, and heartbeats that stand for an operator, reach no vehicle either; they are counted as `withheld`.
  - everything else goes where it would go: telemetry, questions, ADSB_VEHICLE, FOLLOW_TARGET and COLLISION of other vehicles,
    answers to clients; and an autopilot's commands to parts of its vehicle that have an endpoint of their own, on which no
    autopilot is heard.
  """

  import Aerie.Router.ControlMessages, only: [is_station: 1]

  alias Aerie.Mavlink.Message
  alias Aerie.Router.Delivery
  alias Aerie.Router.Endpoint
  alias Aerie.Router.ControlMessages
  alias Aerie.Router.Output
  alias Aerie.Router.Owner
  alias Aerie.Router.EndpointCounters
  alias MavCodec.Enums.MavResult
  alias MavCodec.Frame
  alias MavCodec.Messages.CommandAck

  require Logger

  @heartbeat Message.id!("HEARTBEAT")
  @told_ms 60_000
  @answered_ms 1_000
  @autopilot 1

  @denied MavResult.value(:MAV_RESULT_DENIED)

  @doc "Whether frames from an endpoint may command vehicles."
  @spec open?(Endpoint.t(), Owner.t()) :: boolean
  def open?(_endpoint, %Owner{side: :client}), do: true
  def open?(_endpoint, %Owner{gcs: :allow}), do: true
  def open?(_endpoint, %Owner{gcs: :deny}), do: false
  def open?(%Endpoint{kind: :link, text: text}, %Owner{gcs: :auto}), do: loopback?(text)
  # An endpoint of this program.
  def open?(_endpoint, _owner), do: true

  @doc "Whether an address, as `ADDRESS:PORT` and with IPv6 in brackets, is one that only this machine can send from."
  @spec loopback?(String.t() | nil) :: boolean
  def loopback?(text) when is_binary(text) do
    with [_all, address] <- Regex.run(~r/\A(\[[^\]]+\]|[\d.]+):\d+\z/, text),
         {:ok, address} <- address |> String.trim("[") |> String.trim("]") |> parsed() do
      own?(address)
    else
      _no_address -> false
    end
  end

  def loopback?(_none), do: false

  defp parsed(address), do: address |> String.to_charlist() |> :inet.parse_strict_address()

  defp own?({127, _, _, _}), do: true
  defp own?({0, 0, 0, 0, 0, 0, 0, 1}), do: true
  # ::ffff:127.0.0.1
  defp own?({0, 0, 0, 0, 0, 0xFFFF, high, _low}), do: div(high, 256) == 127
  defp own?(_other), do: false

  @doc "Whether none of the frames changes a vehicle, so that any endpoint may send them. Nearly always so."
  @spec free?([Frame.t()]) :: boolean
  def free?([]), do: true
  def free?([frame | rest]), do: ControlMessages.kind(frame) == nil and free?(rest)

  @doc "The delivery of a guarded broadcast, without the receivers that are closed to it."
  @spec narrow(Frame.t(), Delivery.t()) :: Delivery.t()
  def narrow(frame, %{path: path, source: source} = delivery) do
    shut? = &shut?(path, &1, frame, nil)
    {shut, receivers} = Enum.split_with(source.receivers, shut?)
    grouped = for {_group, paths} <- source.groups, to <- paths, shut?.(to), do: to

    groups =
      for {group, paths} <- source.groups,
          open = Enum.reject(paths, shut?),
          open != [],
          do: {group, open}

    heartbeats = if frame.id == @heartbeat, do: source.heartbeat_receivers, else: []
    if shut != [] or grouped != [] or heartbeats != [], do: refused(frame, nil, delivery)
    %{delivery | source: %{source | receivers: receivers, groups: groups, heartbeat_receivers: []}}
  end

  @doc """
  Those of the endpoints by which a target is reached that are open to a frame: all of them if the delivery is not guarded,
  `:shut` when there were some and none is left.
  """
  @spec open([Endpoint.key()], Frame.t(), target, Delivery.t()) :: [Endpoint.key()] | :shut
        when target: {non_neg_integer, 0..255}
  def open(keys, _frame, _target, %{guarded: false}), do: keys

  def open(keys, frame, target, %{forwarding: %{paths: paths}, path: path} = delivery) do
    shut? = &(&1 != path.key and is_map_key(paths, &1) and shut?(path, paths[&1], frame, target))

    case Enum.split_with(keys, shut?) do
      {[], keys} ->
        keys

      {_shut, open} ->
        refused(frame, Frame.target(frame), delivery)
        if open -- [path.key] == [], do: :shut, else: open
    end
  end

  # An endpoint where no autopilot was heard is a part of a vehicle, a ground station that sends no heartbeat, or a vehicle that
  # has just come. Commands go there from vehicles only, and only those that are for the first two.
  defp shut?(_from, %{side: :client}, _frame, _target), do: false

  defp shut?(%{heard_vehicle: true}, %{heard_vehicle: false}, frame, to),
    do: not fits?(ControlMessages.kind(frame), frame, to)

  defp shut?(_from, _to, _frame, _target), do: true

  defp fits?(:command, _frame, nil), do: false
  defp fits?(:command, _frame, {system, _component}) when is_station(system), do: true
  defp fits?(:command, %{system: system, component: from}, {system, 0}), do: from == @autopilot
  defp fits?(:command, %{system: system}, {system, component}), do: component != @autopilot
  defp fits?(:command, _frame, _another_vehicle), do: false
  defp fits?(_input_or_presence, _frame, _target), do: true

  defp refused(frame, target, %{path: path} = delivery) do
    case ControlMessages.kind(frame) do
      :command ->
        EndpointCounters.add(path.counters, :denied, 1)
        answer(frame, target, delivery)
        tell(frame, target, delivery)

      _input_or_presence ->
        EndpointCounters.add(path.counters, :withheld, 1)
    end
  end

  defp answer(frame, {system, component}, %{path: path, tables: tables}) when system != 0 do
    command = ControlMessages.command(frame)

    if command != nil and path.out != nil and due?(tables, {:answered, path.owner}, @answered_ms) do
      ack = %CommandAck{
        command: command,
        result: @denied,
        target_system: frame.system,
        target_component: frame.component
      }

      Output.bytes(path, MavCodec.encode(ack, system: system, component: max(component, 1)), :ack, 1)
    end

    :ok
  end

  defp answer(_frame, _everyone, _delivery), do: :ok

  defp tell(frame, target, %{path: %{owner: owner} = path, source: source, tables: tables}) do
    if due?(tables, {:told, owner}, @told_ms) do
      metadata = %{
        gateway: path.gateway,
        link: owner,
        network: hd(path.networks),
        peer: path.text,
        system: frame.system,
        component: frame.component,
        message: frame.id
      }

      :telemetry.execute([:aerie, :router, :denied], %{frames: 1}, metadata)

      Logger.warning(
        "link #{owner}: #{path.text || "somebody"} (system #{frame.system}) may not command vehicles by this link: " <>
          "message #{name(frame)} to #{meant(target)} was refused. " <> advice(source)
      )
    end

    :ok
  end

  defp advice(%{autopilot: true}), do: "It says that it is a vehicle: what it sends still goes to clients"

  defp advice(_source) do
    "If that is your ground station, set gcs: allow for this link, or connect it to one of the clients' endpoints"
  end

  defp name(%{id: id}), do: MavCodec.Dialects.All.name(id) || id

  defp meant(nil), do: "all vehicles"
  defp meant({0, _component}), do: "all vehicles"
  defp meant({system, component}), do: "#{system}/#{component}"

  # One entry for each link and purpose. Two at the same moment may both be due, which only says it twice.
  defp due?(%{settings: settings}, what, every_ms) do
    now = System.monotonic_time(:millisecond)
    key = {__MODULE__, what}
    last = :ets.lookup_element(settings, key, 2, nil)
    (last == nil or now - last >= every_ms) and :ets.insert(settings, {key, now})
  end
end
