defmodule MavRouter.Sharing.TransferLock do
  @moduledoc """
  One partner at a time for a vehicle's transfers: whose turn it is (`MavRouter.Sharing.TransferLock.Turn`) for
  missions, for files and for logs (`MavRouter.Sharing.TransferLock.Transfer`) of each vehicle. Without it two ground
  stations that upload at the same time disturb each other's transfer.

  Every forwarding process asks here, for frames of these messages only (`pass/1`); a frame that was held is forwarded by this
  process when its turn comes. Without this process everything passes: order among transfers is worth less than a mission.

  This is the one place where transfers of ground stations and those of the gateway meet: the gateway's own take a turn by `take/3` and
  give it back by `give_back/3`. It is in the router, because the frames of clients are held and forwarded here, and because it
  outlives the processes of a vehicle.

  A client that may not ask vehicles (`MavRouter.Forward.Gate`) gets no turn, so that it keeps nobody waiting.
  """
  use GenServer

  import MavRouter.Sharing.TransferLock.Transfer, only: [is_part: 1]

  alias Aerie.Base.Names
  alias MavRouter.Forward.Delivery
  alias MavRouter.Endpoints
  alias MavRouter.Endpoints.Owner.Filter
  alias MavRouter.Forward
  alias MavRouter.Forward.Cache
  alias MavRouter.Endpoints.Owner.Renumber
  alias MavRouter.Routes
  alias MavRouter.Tables
  alias MavRouter.Forward.Source
  alias MavRouter.Endpoints.Counters
  alias MavRouter.Sharing.TransferLock.Transfer
  alias MavRouter.Sharing.TransferLock.Turn
  alias MavCodec.Frame

  @tick_ms 100
  # A process that is gone is noticed at once. One that is only late decides all the same: what passed meanwhile would be
  # forwarded a second time. No longer, because the link that asks stands still meanwhile.
  @call_ms 5_000
  # Vehicles and kinds of transfer; those beyond it are not serialised.
  @max_turns 4_096

  @typedoc "What a vehicle transfers with one partner at a time."
  @type kind :: Transfer.kind()

  @doc "The kinds of transfers, each of which has turns of its own."
  @spec kinds() :: [kind()]
  defdelegate kinds, to: Transfer

  @doc "Options: `:gateway`; `:clock`, a function that gives the monotonic time of turns in ms, for tests."
  @spec start_link(gateway: Names.gateway(), clock: (-> integer) | nil) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    clock = options[:clock] || (&now/0)
    GenServer.start_link(__MODULE__, {gateway, clock}, name: server(gateway))
  end

  defp server(gateway), do: Names.via(gateway, :transfer_lock)

  @doc "The delivery without the frames that have to wait: they are kept, and forwarded when it is their turn."
  @spec pass(Delivery.t()) :: Delivery.t()
  def pass(%{frames: frames} = delivery) do
    # Nearly always there is none.
    if part?(frames),
      do: %{delivery | frames: Enum.filter(frames, &passes?(&1, delivery))},
      else: delivery
  end

  @doc """
  A transfer of the gateway wants the turn: `:go`; or `{:hold, whose}`, and `{:transfer_turn, vehicle, kind}` comes when it has it. `whose`
  are the ids of the ground station whose turn it is, nil for another transfer of the gateway. The turn ends with `give_back/3` or with
  the calling process. `{:transfer_wanted, vehicle, kind}` comes when a ground station waits for it.
  """
  @spec take(Names.gateway(), MavRouter.Router.vehicle_key(), kind()) ::
          :go | {:hold, {non_neg_integer, 0..255} | nil}
  def take(gateway, vehicle, kind) do
    GenServer.call(server(gateway), {:take, {vehicle, kind}}, @call_ms)
  catch
    :exit, _no_process -> :go
  end

  @doc "A transfer of the gateway has ended, or does not wait any more."
  @spec give_back(Names.gateway(), MavRouter.Router.vehicle_key(), kind()) :: :ok
  def give_back(gateway, vehicle, kind),
    do: GenServer.cast(server(gateway), {:give_back, {vehicle, kind}, self()})

  @doc "What is being transferred, or waits for its turn: between vehicles and ground stations, or the gateway."
  @spec turns(Names.gateway()) :: [{MavRouter.Router.vehicle_key(), kind()}]
  def turns(gateway) do
    GenServer.call(server(gateway), :turns, @call_ms)
  catch
    :exit, _no_process -> []
  end

  defp part?([]), do: false
  defp part?([%{id: id} | _rest]) when is_part(id), do: true
  defp part?([_other | rest]), do: part?(rest)

  defp passes?(%{id: id}, _delivery) when not is_part(id), do: true
  defp passes?(_frame, %{path: %{role: :read_only}}), do: true

  # A vehicle's answers are only looked at, and only while somebody has a turn there.
  defp passes?(frame, %{source: %{autopilot: true}, path: path} = delivery) do
    vehicle = {hd(path.networks), frame.system}

    _ =
      with true <- turn?(delivery, vehicle),
           {kind, step, part} <- Transfer.answered(frame),
           # Logs are sent to everybody.
           to = Frame.target(frame) || {0, 0},
           do: GenServer.cast(server(delivery.gateway), {:answered, {vehicle, kind}, to, step, part})

    true
  end

  # A frame that reaches no vehicle delays no other sender.
  defp passes?(_frame, %{scope: scope}) when scope != :cleared, do: true

  defp passes?(frame, %{path: path} = delivery) do
    with true <- Filter.pass?(path.in, frame, path.owner),
         {kind, step, part} <- Transfer.asked(frame),
         {_network, _system} = vehicle <- vehicle(Frame.target(frame), delivery) do
      ask(frame, {vehicle, kind}, step, part, delivery)
    else
      _no_transfer -> true
    end
  end

  defp ask(frame, key, step, part, %{path: path} = delivery) do
    who = {path.key, frame.system, frame.component}

    # A frame that waits must not keep the whole read in memory.
    frame = %{frame | bytes: :binary.copy(frame.bytes), payload: :binary.copy(frame.payload)}

    case GenServer.call(server(delivery.gateway), {:ask, key, who, step, part, frame}, @call_ms) do
      :go -> true
      :hold -> Counters.add(path.counters, :held, 1) != :ok
      :refuse -> Counters.add(path.counters, :out_of_turn, 1) != :ok
    end
  catch
    :exit, _no_process -> true
  end

  defp turn?(%{tables: tables}, vehicle), do: :ets.member(tables.settings, {:transfer, vehicle})

  # The vehicle that is meant, when one is known by that id: the first of the networks that the sender sees decides.
  defp vehicle(target, _delivery) when target == nil or elem(target, 0) == 0, do: nil

  defp vehicle({id, _component}, %{tables: tables, forwarding: forwarding, path: path}) do
    Enum.find_value(path.networks, fn network ->
      vehicle = {network, Renumber.meant(path.renumber, network, id)}
      keys = if elem(vehicle, 1), do: Routes.endpoints(tables, vehicle), else: []

      if Enum.any?(keys, &match?(%{^&1 => %{side: :vehicle, heard_vehicle: true}}, forwarding.paths)),
        do: vehicle
    end)
  end

  @impl GenServer
  def init({gateway, clock}) do
    Process.set_label({:transfer_lock, gateway})
    tables = Tables.of(gateway)
    if tables, do: :ets.match_delete(tables.settings, {{:transfer, :_}, :_})
    {:ok, %{gateway: gateway, clock: clock, turns: %{}, own: %{}, timer: nil, cache: nil}}
  end

  @impl GenServer
  def handle_call({:ask, key, who, step, part, frame}, _from, state) do
    {answer, turn} =
      state.turns |> Map.get(key, Turn.new()) |> Turn.ask(who, step, part, {who, frame}, state.clock.())

    if map_size(state.turns) >= @max_turns and not is_map_key(state.turns, key) do
      {:reply, :go, state}
    else
      if answer == :hold, do: wanted(turn.who, key)
      {:reply, answer, state |> keep(key, turn) |> let_go(key)}
    end
  end

  def handle_call({:take, {vehicle, kind} = key}, {pid, _tag}, state) do
    turn = Map.get(state.turns, key, Turn.new())
    whose = with {_path, system, component} <- turn.who, do: {system, component}, else: (_own -> nil)

    {answer, turn} =
      Turn.take(turn, {:gateway, pid}, {:tell, pid, {:transfer_turn, vehicle, kind}}, state.clock.())

    own = Map.put_new_lazy(state.own, {key, pid}, fn -> Process.monitor(pid) end)
    state = %{state | own: own} |> keep(key, turn) |> let_go(key)
    {:reply, if(answer == :go, do: :go, else: {:hold, whose}), state}
  end

  def handle_call(:turns, _from, state), do: {:reply, Map.keys(state.turns), state}

  @impl GenServer
  def handle_cast({:give_back, key, pid}, state), do: {:noreply, given_back(state, key, pid)}

  def handle_cast({:answered, key, to, step, part}, state) do
    case state.turns do
      %{^key => turn} ->
        {:noreply, state |> keep(key, Turn.answered(turn, to, step, part, state.clock.())) |> let_go(key)}

      _over ->
        {:noreply, state}
    end
  end

  @impl GenServer
  def handle_info(:tick, state) do
    {:noreply, Enum.reduce(Map.keys(state.turns), %{state | timer: nil}, &let_go(&2, &1)) |> timed()}
  end

  def handle_info({:DOWN, _monitor, :process, pid, _reason}, state) do
    keys = for {{key, ^pid}, _monitor} <- state.own, do: key
    {:noreply, Enum.reduce(keys, state, &given_back(&2, &1, pid))}
  end

  # A transfer of the gateway may give way.
  defp wanted({:gateway, pid}, {vehicle, kind}), do: send(pid, {:transfer_wanted, vehicle, kind})
  defp wanted(_station, _key), do: :ok

  defp given_back(state, key, pid) do
    {monitor, own} = Map.pop(state.own, {key, pid})
    if monitor, do: Process.demonitor(monitor, [:flush])
    turn = state.turns |> Map.get(key, Turn.new()) |> Turn.give_back({:gateway, pid})
    %{state | own: own} |> keep(key, turn) |> let_go(key)
  end

  # After every change: gives the turn to the next in the queue.
  defp let_go(state, key) do
    case state.turns do
      %{^key => turn} ->
        {items, gave_up, turn} = Turn.next(turn, state.clock.())
        Enum.each(gave_up, &count(state.gateway, &1))
        items |> Enum.reduce(state, &forward/2) |> keep(key, turn)

      _none ->
        state
    end
  end

  defp keep(state, {vehicle, _kind} = key, turn) do
    turns = if Turn.idle?(turn), do: Map.delete(state.turns, key), else: Map.put(state.turns, key, turn)
    mark(state.gateway, vehicle, Enum.any?(Transfer.kinds(), &is_map_key(turns, {vehicle, &1})))
    timed(%{state | turns: turns})
  end

  defp mark(gateway, vehicle, busy?) do
    case Tables.of(gateway) do
      nil -> :ok
      tables when busy? -> :ets.insert(tables.settings, {{:transfer, vehicle}, true})
      tables -> :ets.delete(tables.settings, {:transfer, vehicle})
    end
  end

  defp timed(%{timer: nil, turns: turns} = state) when turns != %{},
    do: %{state | timer: Process.send_after(self(), :tick, @tick_ms)}

  defp timed(state), do: state

  # It waited in vain: its sender has stopped asking.
  defp count(gateway, {{key, _system, _component}, _frame}) do
    with tables when tables != nil <- Tables.of(gateway),
         %{counters: counters} <- Endpoints.get(tables, key),
         do: Counters.add(counters, :out_of_turn, 1)
  end

  defp forward({:tell, pid, turn}, state) do
    send(pid, turn)
    state
  end

  # As if it came now. A sender that is gone meanwhile waits for nothing.
  defp forward({{key, _system, _component}, frame}, %{gateway: gateway} = state) do
    with tables when tables != nil <- Tables.of(gateway),
         cache = Cache.refresh(state.cache, tables),
         %Delivery{} = delivery <- Cache.delivery(cache, gateway, tables, key) do
      source = Cache.source(cache, key, frame.system, frame.component)
      %{delivery | source: source, frames: [frame], scope: :cleared} |> Source.refresh() |> Forward.frames()
      %{state | cache: cache}
    else
      _gone -> state
    end
  end

  defp now, do: :erlang.monotonic_time(:millisecond)
end
