defmodule Aerie.Router.Turns do
  @moduledoc """
  One partner at a time for a vehicle's transfers: whose turn it is (`Aerie.Router.Turns.Turn`) for missions and for files
  (`Aerie.Router.Turns.Transfer`) of each vehicle. Without it two ground stations that upload at once fall into each other's
  transfer.

  Every process that forwards asks here, for frames of these messages only (`pass/6`); what is held is forwarded from this
  process when its turn comes. Is this process away, everything passes: serialising is worth less than a mission.

  Who may not command vehicles (`Aerie.Router.Gate`) gets no turn, so that it can keep nobody waiting: it may read a mission
  while nobody else has a transfer.
  """
  use GenServer

  import Aerie.Router.Turns.Transfer, only: [is_part: 1]

  alias Aerie.Names
  alias Aerie.Router.Filter
  alias Aerie.Router.Forward
  alias Aerie.Router.Local
  alias Aerie.Router.Plan
  alias Aerie.Router.Plan.Way
  alias Aerie.Router.Renumber
  alias Aerie.Router.Routes
  alias Aerie.Router.Tables
  alias Aerie.Router.Talker
  alias Aerie.Router.Tally
  alias Aerie.Router.Turns.Transfer
  alias Aerie.Router.Turns.Turn
  alias Aerie.Successor
  alias MavCodec.Frame

  @tick_ms 100
  @call_ms 1_000
  # Vehicles and kinds; whoever comes beyond it is not serialised.
  @max_turns 4_096

  @doc "Options: `:gateway`."
  @spec start_link(gateway: Names.gateway()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    name = Names.via(gateway, :router_turns)
    Successor.start(fn -> GenServer.start_link(__MODULE__, gateway, name: name) end)
  end

  @doc "The frames that go on now; those that have to wait do so, and go on by themselves."
  @spec pass(Names.gateway(), Tables.t(), Plan.t(), Way.t(), Talker.t(), [Frame.t()]) :: [Frame.t()]
  def pass(gateway, tables, plan, way, talker, frames) do
    # Nearly always there is none.
    if part?(frames), do: Enum.filter(frames, &goes?(gateway, tables, plan, way, talker, &1)), else: frames
  end

  defp part?([]), do: false
  defp part?([%{id: id} | _rest]) when is_part(id), do: true
  defp part?([_other | rest]), do: part?(rest)

  defp goes?(_gateway, _tables, _plan, _way, _talker, %{id: id}) when not is_part(id), do: true
  defp goes?(_gateway, _tables, _plan, %{role: :read_only}, _talker, _frame), do: true

  # A vehicle's answers are only looked at, and only while somebody has a turn there.
  defp goes?(gateway, tables, _plan, way, %{autopilot: true}, frame) do
    vehicle = {hd(way.networks), frame.system}

    _ =
      with true <- :ets.member(tables.settings, {:turn, vehicle}),
           {kind, said, part} <- Transfer.answered(frame),
           to when to != nil <- Frame.target(frame),
           do: GenServer.cast(Names.via(gateway, :router_turns), {:heard, {vehicle, kind}, to, said, part})

    true
  end

  defp goes?(gateway, tables, plan, way, _talker, frame) do
    with true <- Filter.pass?(way.in, frame, way.owner),
         {kind, said, part} <- Transfer.asked(frame),
         {_network, _system} = vehicle <- vehicle(tables, plan, way, Frame.target(frame)) do
      asked(gateway, tables, way, {vehicle, kind}, said, part, frame)
    else
      _no_transfer -> true
    end
  end

  defp asked(_gateway, tables, %{commands: false} = way, {vehicle, _kind}, _said, _part, _frame) do
    free? = not :ets.member(tables.settings, {:turn, vehicle})
    if not free?, do: Tally.add(way.tally, :withheld, 1)
    free?
  end

  defp asked(gateway, _tables, way, key, said, part, frame) do
    who = {way.key, frame.system, frame.component}

    # What waits must not keep the whole read alive that it is a part of.
    frame = %{frame | bytes: :binary.copy(frame.bytes), payload: :binary.copy(frame.payload)}

    case GenServer.call(Names.via(gateway, :router_turns), {:ask, key, who, said, part, frame}, @call_ms) do
      :go -> true
      :hold -> Tally.add(way.tally, :held, 1) != :ok
      :refuse -> Tally.add(way.tally, :out_of_turn, 1) != :ok
    end
  catch
    :exit, _away -> true
  end

  # The vehicle that is meant, when one is known by that id: the first of the networks that the sender sees.
  defp vehicle(_tables, _plan, _way, target) when target == nil or elem(target, 0) == 0, do: nil

  defp vehicle(tables, plan, way, {id, _component}) do
    Enum.find_value(way.networks, fn network ->
      vehicle = {network, Renumber.meant(way.renumber, network, id)}
      keys = if elem(vehicle, 1), do: Routes.ways(tables, vehicle), else: []
      if Enum.any?(keys, &match?(%{^&1 => %{side: :vehicle, heard_vehicle: true}}, plan.ways)), do: vehicle
    end)
  end

  @impl GenServer
  def init(gateway) do
    Process.set_label({:router_turns, gateway})
    tables = Tables.of(gateway)
    if tables, do: :ets.match_delete(tables.settings, {{:turn, :_}, :_})
    {:ok, %{gateway: gateway, turns: %{}, timer: nil}}
  end

  @impl GenServer
  def handle_call({:ask, key, who, said, part, frame}, _from, state) do
    {answer, turn} = state.turns |> Map.get(key, Turn.new()) |> Turn.ask(who, said, part, {who, frame}, now())

    if map_size(state.turns) >= @max_turns and not is_map_key(state.turns, key),
      do: {:reply, :go, state},
      else: {:reply, answer, state |> keep(key, turn) |> let_go(key)}
  end

  @impl GenServer
  def handle_cast({:heard, key, to, said, part}, state) do
    case state.turns do
      %{^key => turn} ->
        {:noreply, state |> keep(key, Turn.heard(turn, to, said, part, now())) |> let_go(key)}

      _over ->
        {:noreply, state}
    end
  end

  @impl GenServer
  def handle_info(:tick, state) do
    {:noreply, Enum.reduce(Map.keys(state.turns), %{state | timer: nil}, &let_go(&2, &1)) |> timed()}
  end

  # After every change: who is next, if it is anybody's turn now.
  defp let_go(state, key) do
    case state.turns do
      %{^key => turn} ->
        {items, gave_up, turn} = Turn.next(turn, now())
        Enum.each(gave_up, &count(state.gateway, &1))
        Enum.each(items, &forward(state.gateway, &1))
        keep(state, key, turn)

      _none ->
        state
    end
  end

  defp keep(state, {vehicle, _kind} = key, turn) do
    turns = if Turn.idle?(turn), do: Map.delete(state.turns, key), else: Map.put(state.turns, key, turn)
    mark(state.gateway, vehicle, Enum.any?([:mission, :file], &is_map_key(turns, {vehicle, &1})))
    timed(%{state | turns: turns})
  end

  defp mark(gateway, vehicle, busy?) do
    case Tables.of(gateway) do
      nil -> :ok
      tables when busy? -> :ets.insert(tables.settings, {{:turn, vehicle}, true})
      tables -> :ets.delete(tables.settings, {:turn, vehicle})
    end
  end

  defp timed(%{timer: nil, turns: turns} = state) when turns != %{},
    do: %{state | timer: Process.send_after(self(), :tick, @tick_ms)}

  defp timed(state), do: state

  # It waited in vain: who said it has stopped asking.
  defp count(gateway, {{key, _system, _component}, _frame}) do
    with tables when tables != nil <- Tables.of(gateway),
         %{plan: %{ways: %{^key => way}}} <- Local.fetch(gateway, tables),
         do: Tally.add(way.tally, :out_of_turn, 1)
  end

  # As if it came now. Who is gone meanwhile waits for nothing.
  defp forward(gateway, {{key, _system, _component}, frame}) do
    with tables when tables != nil <- Tables.of(gateway),
         %{plan: %{ways: %{^key => way}} = plan} = local <- Local.fetch(gateway, tables) do
      talker =
        local
        |> Local.talker(key, frame.system, frame.component)
        |> Talker.refresh(tables, plan, way, false, now())

      Forward.frames(tables, plan, way, talker, [frame], now())
    else
      _gone -> :ok
    end
  end

  defp now, do: :erlang.monotonic_time(:millisecond)
end
