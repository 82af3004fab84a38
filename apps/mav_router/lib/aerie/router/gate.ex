defmodule Aerie.Router.Gate do
  @moduledoc """
  Which end may command vehicles: what of `Aerie.Router.Orders` goes from an end to the vehicles behind other ends.

  A **client** (`clients`, WebSockets, unix sockets) may: whoever opened it decided so. Of an end of a **link** the link's
  `gcs` decides:

  | `gcs` | |
  |---|---|
  | `:auto` (default) | only what this machine itself sends: ends with a loopback address |
  | `:allow` | whoever reaches the link commands |
  | `:deny` | nobody does, this machine neither |

  From an end that may not,

  - orders reach no vehicle, whoever they are addressed to: those of a ground station that called the link, of a program
    that says nothing of itself, and of one that says it is a vehicle. Counted as `denied`, told in the log once a minute
    for each link, and a COMMAND_LONG or COMMAND_INT is answered with DENIED, once a second for each link, so that a lost
    answer costs nothing and an invented sender gains nothing (the answer is shorter than the command).
  - what vehicles believe, and heartbeats that stand for an operator, reach no vehicle either; counted as `withheld`.
  - everything else goes where it did: telemetry, questions, ADSB_VEHICLE, FOLLOW_TARGET and COLLISION of other vehicles,
    answers to clients; and an autopilot's orders to parts of it that call by a way of their own, where no autopilot is heard.
  """

  alias Aerie.Router.Endpoint
  alias Aerie.Router.Orders
  alias Aerie.Router.Out
  alias Aerie.Router.Owner
  alias Aerie.Router.Plan.Way
  alias Aerie.Router.Tables
  alias Aerie.Router.Talker
  alias Aerie.Router.Tally
  alias MavCodec.Enums.MavResult
  alias MavCodec.Frame
  alias MavCodec.Messages.CommandAck

  require Logger

  @told_ms 60_000
  @answered_ms 1_000
  @autopilot 1
  # Ids from here on are ground stations' by convention.
  @ground_stations 240
  @denied MavResult.value(:MAV_RESULT_DENIED)

  @doc "Whether what comes from an endpoint of an owner may command vehicles."
  @spec open?(Endpoint.t(), Owner.t()) :: boolean
  def open?(_endpoint, %Owner{side: :client}), do: true
  def open?(_endpoint, %Owner{gcs: :allow}), do: true
  def open?(_endpoint, %Owner{gcs: :deny}), do: false
  def open?(%Endpoint{kind: :link, text: text}, %Owner{gcs: :auto}), do: loopback?(text)
  # A process of this program.
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

  @doc "Whether frames of an end that may not command are all such as everyone may send. Nearly always so."
  @spec free?([Frame.t()]) :: boolean
  def free?([]), do: true
  def free?([frame | rest]), do: Orders.kind(frame) == nil and free?(rest)

  @doc "Where a broadcast that is guarded goes: the talker without the vehicles that are closed to it."
  @spec narrow(Talker.t(), Way.t(), Frame.t(), Tables.t()) :: Talker.t()
  def narrow(talker, way, frame, tables) do
    shut? = &shut?(way, &1, frame, nil)
    {shut, everyone} = Enum.split_with(talker.everyone, shut?)
    grouped = for {_group, ways} <- talker.groups, to <- ways, shut?.(to), do: to

    groups =
      for {group, ways} <- talker.groups,
          open = Enum.reject(ways, shut?),
          open != [],
          do: {group, open}

    heartbeats = if frame.id == 0, do: talker.heartbeats, else: []
    if shut != [] or grouped != [] or heartbeats != [], do: refused(way, frame, nil, tables)
    %{talker | everyone: everyone, groups: groups, heartbeats: []}
  end

  @doc """
  The ways by which the addressee of a frame is reached that are open to it, all of them where the frame is not guarded;
  `:shut` when there were some and none is left.
  """
  @spec open([Endpoint.key()], %{Endpoint.key() => Way.t()}, Way.t(), Frame.t(), target, Tables.t()) ::
          [Endpoint.key()] | :shut
        when target: {non_neg_integer, 0..255}
  def open(keys, _ways, %{guarded: false}, _frame, _target, _tables), do: keys

  def open(keys, ways, way, frame, target, tables) do
    shut? = &(&1 != way.key and is_map_key(ways, &1) and shut?(way, ways[&1], frame, target))

    case Enum.split_with(keys, shut?) do
      {[], keys} ->
        keys

      {_shut, open} ->
        refused(way, frame, Frame.target(frame), tables)
        if open -- [way.key] == [], do: :shut, else: open
    end
  end

  # An end of which no autopilot is known is a part of a vehicle, a ground station that says no heartbeat, or a vehicle that
  # has just come: orders go there from vehicles only, and only those that are for the first two.
  defp shut?(_from, %{side: :client}, _frame, _target), do: false

  defp shut?(%{heard_vehicle: true}, %{heard_vehicle: false}, frame, to),
    do: not fits?(Orders.kind(frame), frame, to)

  defp shut?(_from, _to, _frame, _target), do: true

  defp fits?(:order, _frame, nil), do: false
  defp fits?(:order, _frame, {system, _component}) when system >= @ground_stations, do: true
  defp fits?(:order, %{system: system, component: from}, {system, 0}), do: from == @autopilot
  defp fits?(:order, %{system: system}, {system, component}), do: component != @autopilot
  defp fits?(:order, _frame, _another_vehicle), do: false
  defp fits?(_input_or_presence, _frame, _target), do: true

  defp refused(way, frame, target, tables) do
    case Orders.kind(frame) do
      :order ->
        Tally.add(way.tally, :denied, 1)
        answer(way, frame, target, tables)
        tell(way, frame, target, tables)

      _input_or_presence ->
        Tally.add(way.tally, :withheld, 1)
    end
  end

  defp answer(way, frame, {system, component}, tables) when system != 0 do
    command = Orders.command(frame)

    if command != nil and way.out != nil and due?(tables, {:answered, way.owner}, @answered_ms) do
      bytes =
        MavCodec.encode(
          %CommandAck{
            command: command,
            result: @denied,
            target_system: frame.system,
            target_component: frame.component
          },
          system: system,
          component: max(component, 1)
        )

      Out.bytes(way, bytes, :ack, 1)
    end

    :ok
  end

  defp answer(_way, _frame, _everyone, _tables), do: :ok

  defp tell(%{owner: owner} = way, frame, target, tables) do
    if due?(tables, {:told, owner}, @told_ms) do
      metadata = %{
        gateway: way.gateway,
        link: owner,
        network: hd(way.networks),
        peer: way.text,
        system: frame.system,
        component: frame.component,
        message: frame.id
      }

      :telemetry.execute([:aerie, :router, :denied], %{frames: 1}, metadata)

      Logger.warning(
        "link #{owner}: #{way.text || "somebody"} (system #{frame.system}) may not command vehicles by this link: " <>
          "message #{name(frame)} to #{meant(target)} was refused. If that is your ground station, set gcs: allow " <>
          "for this link, or connect it to one of the clients' endpoints"
      )
    end

    :ok
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
