defmodule Aerie.Control.ReadCache.Vehicle do
  @moduledoc """
  Answers ground stations for one vehicle: runs `Aerie.Control.Params.Responder` and `Protocols.Mission.Responder` with a clock, the vehicle's messages, and reads in
  tasks. It never blocks. A list is sent in portions that fit into a station's socket.
  """
  use GenServer, restart: :transient

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.{Missions, Params, ReadCache}
  alias Aerie.Control.Policy.Mavlink.Writing.Aboard
  alias Protocols.Mission
  alias Aerie.Vehicle.Firmware
  alias MavCodec.Ftp.Packet
  alias MavCodec.Messages, as: M

  @listens Enum.map([M.ParamValue, M.MissionCurrent, M.MissionAck, M.MissionCount, M.HomePosition], & &1.id())
  @kinds %{0 => :mission, 1 => :fence, 2 => :rally}
  # Whose reading is answered to nobody: the policy's.
  @nobody {0, 0}
  @fence 1
  @relearn_ms 1_000
  @max_stations 256
  @portion 20
  @portion_ms 5
  @session_ms 500

  @spec start_link(gateway: Names.gateway(), key: Store.vehicle_key()) :: GenServer.on_start()
  def start_link(options),
    do:
      GenServer.start_link(__MODULE__, options,
        name: Names.via(options[:gateway], :read_cache, options[:key])
      )

  @impl GenServer
  def init(gateway: gateway, key: key) do
    Process.set_label({:read_cache, key})
    {:ok, tasks} = Task.Supervisor.start_link()
    for type <- Map.keys(@kinds), do: Aboard.forget(gateway, key, type)

    state = %{
      gateway: gateway,
      key: key,
      tasks: tasks,
      running: %{},
      session: nil,
      vehicle: nil,
      params: nil,
      plans: nil,
      frames: %{},
      endpoints: %{},
      old: %{},
      out: %{},
      seq: 0,
      timer: nil,
      router_cache: nil,
      relearned: 0
    }

    {:ok, state |> listen() |> known()}
  end

  @impl GenServer
  def handle_call({:station, endpoint, frame, message}, _from, state) do
    state = known(state)

    case {state, ReadCache.about(message)} do
      {%{vehicle: vehicle, session: session}, _any} when vehicle == nil or session == nil ->
        {:reply, :forward, state}

      {_state, :params} ->
        station(:params, {:params, endpoint}, message, endpoint, frame, state)

      {_state, :files} ->
        station(:params, {:file, endpoint, {frame.system, frame.component}}, message, endpoint, frame, state)

      {_state, :plans} ->
        station(:plans, {frame.system, frame.component}, message, endpoint, frame, state)
    end
  end

  # A message that is forwarded at once is not absorbed; a request that may have to wait is kept.
  defp station(part, from, message, endpoint, frame, state) do
    state = spoken(state, endpoint, frame.version)
    state = if part == :plans, do: met(state, from, endpoint), else: state
    {served, actions} = served(part).handle(Map.fetch!(state, part), {:station, message, from, now()})
    # Somebody writes it.
    state = if part == :plans, do: publish(%{state | relearned: 0}, served), else: state
    {now, later} = Enum.split_with(actions, &forward?(&1, from, message))
    waits? = now == [] and waits?(message)
    state = if waits?, do: put_in(state.frames[{part, from}], {endpoint, frame}), else: state
    state = Enum.reduce(later, Map.put(state, part, served), &act(&1, &2, part))
    {:reply, if(now == [], do: :absorb, else: :forward), state}
  end

  # Endpoints that speak MAVLink 1, which are answered in it.
  defp spoken(%{old: old} = state, endpoint, 1) do
    old = if map_size(old) < @max_stations, do: old, else: %{}
    %{state | old: Map.put(old, endpoint, true)}
  end

  defp spoken(state, endpoint, 2), do: %{state | old: Map.delete(state.old, endpoint)}

  defp waits?(%module{}), do: module in [M.ParamRequestList, M.MissionRequestList, M.FileTransferProtocol]

  # Messages about plans have the station as their target.
  defp met(%{endpoints: met} = state, from, endpoint) do
    met = if map_size(met) < @max_stations or is_map_key(met, from), do: met, else: %{}
    %{state | endpoints: Map.put(met, from, endpoint)}
  end

  defp forward?({:forward, from}, from, _message), do: true
  defp forward?({:forward, message, from}, from, message), do: true
  defp forward?(_other, _from, _message), do: false

  @impl GenServer
  def handle_cast({:learn, type}, state), do: learn(type, state)

  defp learn(type, state) do
    state = known(state)

    plan = state.plans && state.plans.plans[type]

    cond do
      state.vehicle == nil -> {:noreply, state}
      plan == nil -> {:noreply, read(state, type)}
      published?(state.gateway, state.key, type, plan) -> {:noreply, state}
      # It was written since, which the vehicle's messages have not shown yet.
      true -> {:noreply, state |> event(:plans, {:written, type, now()}) |> read(type)}
    end
  end

  defp read(state, type),
    do: event(state, :plans, {:station, %M.MissionRequestList{mission_type: type}, @nobody, now()})

  @impl GenServer
  def handle_info({:frames, frames}, state), do: {:noreply, Enum.reduce(frames, state, &receive_frame/2)}
  def handle_info(:learn_fence, state), do: learn(@fence, state)
  def handle_info({:rebooted, _boot_ms}, state), do: {:noreply, both(state, {:rebooted, now()})}
  def handle_info(:session, state), do: {:noreply, listen(state)}

  # Messages may have been missed meanwhile.
  def handle_info({:DOWN, session, :process, _pid, _reason}, %{session: session} = state) do
    Process.send_after(self(), :session, @session_ms)
    {:noreply, both(%{state | session: nil}, {:rebooted, now()})}
  end

  def handle_info({task, result}, state) when is_map_key(state.running, task) do
    Process.demonitor(task, [:flush])
    {what, running} = Map.pop!(state.running, task)
    {:noreply, ended(what, result, %{state | running: running})}
  end

  def handle_info({:DOWN, task, :process, _pid, _crash}, state) when is_map_key(state.running, task) do
    {what, running} = Map.pop!(state.running, task)
    {:noreply, ended(what, :error, %{state | running: running})}
  end

  def handle_info(:portion, state), do: {:noreply, portion(%{state | timer: nil})}
  def handle_info(_text_or_late, state), do: {:noreply, state}

  defp listen(state) do
    case Names.whereis(state.gateway, :session, state.key) do
      nil ->
        Process.send_after(self(), :session, @session_ms)
        state

      pid ->
        send(pid, {:listen, self(), @listens})
        %{state | session: Process.monitor(pid)}
    end
  end

  # The firmware decides how the vehicle is read; with another one it is another vehicle.
  defp known(state) do
    case Store.vehicle(state.gateway, state.key) do
      %{autopilot: autopilot, component: component, id: id, status: status}
      when component != nil and status != :lost ->
        vehicle = %{autopilot: autopilot, component: component, id: id}
        if vehicle == state.vehicle, do: state, else: begun(%{state | vehicle: vehicle})

      _not_heard ->
        %{state | vehicle: nil}
    end
  end

  defp begun(%{vehicle: %{autopilot: autopilot}} = state) do
    protocol = Firmware.of(autopilot)
    for type <- Map.keys(@kinds), do: Aboard.forget(state.gateway, state.key, type)
    # A new fence is compared with it, for those without the permission to take it away.
    if protocol.traits().fences?, do: GenServer.cast(self(), {:learn, @fence})

    %{
      state
      | params: Params.Responder.new(protocol.traits().param_encoding),
        plans: Mission.Responder.new(protocol)
    }
  end

  defp receive_frame(frame, %{vehicle: %{component: component}} = state) when frame.component == component do
    case MavCodec.decode(frame) do
      {:ok, %M.ParamValue{} = message} ->
        event(state, :params, {:vehicle, message, now()})

      {:ok, %M.MissionAck{mission_type: type, type: error} = message} when error != 0 and type in 0..2 ->
        Aboard.unsent(state.gateway, state.key, type)
        event(state, :plans, {:vehicle, message, now()})

      {:ok, message} ->
        event(state, :plans, {:vehicle, message, now()})

      {:error, _unknown} ->
        state
    end
  end

  defp receive_frame(_frame, state), do: state

  defp both(%{params: nil} = state, _event), do: state
  defp both(state, event), do: state |> event(:params, event) |> event(:plans, event)

  defp event(state, part, event) do
    {served, actions} = served(part).handle(Map.fetch!(state, part), event)
    state = if part == :plans, do: publish(state, served), else: state
    Enum.reduce(actions, Map.put(state, part, served), &act(&1, &2, part))
  end

  # What the vehicle has, for the policy.
  defp publish(%{gateway: gateway, key: key, plans: before} = state, after_) do
    for type <- Map.keys(@kinds), before.plans[type] != after_.plans[type] do
      with false <- published?(gateway, key, type, after_.plans[type]), do: Aboard.forget(gateway, key, type)
    end

    if is_map_key(before.plans, @fence) and not is_map_key(after_.plans, @fence),
      do: relearn(state),
      else: state
  end

  defp published?(_gateway, _key, _type, nil), do: false

  defp published?(gateway, key, type, plan),
    do: Aboard.read(gateway, key, type, Tuple.to_list(plan.items), plan.read_at)

  # The next fence is compared with it. The more often nobody wrote it, the later.
  defp relearn(%{relearned: n} = state) do
    Process.send_after(self(), :learn_fence, @relearn_ms * 2 ** min(n, 8))
    %{state | relearned: n + 1}
  end

  defp served(:params), do: Params.Responder
  defp served(:plans), do: Mission.Responder

  # --- Actions

  defp act({:reply, from, messages}, state, :params) do
    state = %{state | frames: Map.delete(state.frames, {:params, from})}

    case from do
      {:params, _endpoint} -> queue(state, from, messages)
      {:file, _endpoint, station} -> queue(state, from, Enum.map(messages, &Packet.message(&1, station)))
    end
  end

  defp act({:reply, message}, state, :plans) do
    from = {message.target_system, message.target_component}
    state = %{state | frames: Map.delete(state.frames, {:plans, from})}

    case state.endpoints do
      %{^from => endpoint} -> send_out(state, endpoint, [message])
      _gone -> state
    end
  end

  defp act({:forward, from}, state, :params), do: forwarded(state, {:params, from})
  defp act({:forward, _message, from}, state, :plans), do: forwarded(state, {:plans, from})

  defp act(:fetch, %{vehicle: %{id: id}, gateway: gateway} = state, :params),
    do: task(state, :params, fn -> Params.list(gateway, id) end)

  defp act({:fetch, type}, %{vehicle: %{id: id}, gateway: gateway} = state, :plans),
    do:
      task(state, {:plan, type}, fn -> Missions.read(gateway, id, Map.fetch!(@kinds, type), yields: true) end)

  defp task(state, what, fun) do
    task = Task.Supervisor.async_nolink(state.tasks, fun)
    put_in(state.running[task.ref], what)
  end

  defp ended(:params, {:ok, table}, state), do: event(state, :params, {:listed, table, now()})
  defp ended(:params, _error, state), do: event(state, :params, {:unlisted, now()})
  defp ended({:plan, type}, {:ok, result}, state), do: event(state, :plans, {:read, type, result, now()})
  defp ended({:plan, type}, _error, state), do: event(state, :plans, {:unread, type, now()})

  defp forwarded(state, waiting) do
    case Map.pop(state.frames, waiting) do
      {{endpoint, frame}, frames} ->
        # Not in this process, because the frame may be routed back to it.
        {:ok, _pid} =
          Task.Supervisor.start_child(state.tasks, fn ->
            MavRouter.Sharing.ReadCache.forward(state.gateway, endpoint, frame)
          end)

        %{state | frames: frames}

      {nil, _frames} ->
        state
    end
  end

  # --- Sending

  # A newer list replaces one that is being sent.
  defp queue(state, from, [_one] = messages), do: send_out(state, elem(from, 1), messages)
  defp queue(state, from, messages), do: timed(put_in(state.out[from], messages))

  defp portion(state) do
    {out, state} =
      Enum.reduce(state.out, {%{}, state}, fn {from, messages}, {out, state} ->
        {some, rest} = Enum.split(messages, @portion)
        {if(rest == [], do: out, else: Map.put(out, from, rest)), send_out(state, elem(from, 1), some)}
      end)

    timed(%{state | out: out})
  end

  defp timed(%{timer: nil, out: out} = state) when out != %{},
    do: %{state | timer: Process.send_after(self(), :portion, @portion_ms)}

  defp timed(state), do: state

  defp send_out(%{key: {_network, system}, vehicle: %{component: component}} = state, endpoint, messages) do
    version = if system <= 255 and is_map_key(state.old, endpoint), do: 1, else: 2
    options = [system: system, component: component, version: version]

    {frames, seq} =
      Enum.map_reduce(messages, state.seq, fn message, seq ->
        {MavCodec.encode(message, [seq: seq] ++ options), rem(seq + 1, 256)}
      end)

    cache = MavRouter.Sharing.ReadCache.answer(state.gateway, endpoint, frames, state.router_cache)
    Store.count(state.gateway, :served_messages, length(frames))
    %{state | seq: seq, router_cache: cache}
  end

  defp send_out(state, _endpoint, _messages), do: state

  defp now, do: System.monotonic_time(:microsecond)
end
