defmodule Aerie.Control.TransferExecutor do
  @moduledoc """
  The process that carries out the transfers of one vehicle: `Aerie.Control.TransferExecutor.Core` with a clock, a path to the vehicle, and
  the turn among ground stations (`MavRouter.Sharing.TransferLock`).

  As the executor of commands does, it sends through the vehicle's session, and is handed frames only while a transfer is under way.
  It has a supervisor of its own in the vehicle's tree, so that its death ends the transfers and nothing else.

  Nothing here asks whether somebody may do it: `Aerie.Control.Params`, `Aerie.Control.Missions`, `Aerie.Control.Files` and `Aerie.Control.Logs` do.
  """
  use GenServer

  import Aerie.Vehicle.Session.CoreProcess, only: [now: 0]

  alias Aerie.Base.{Names, Store}
  alias Aerie.Vehicle.Firmware
  alias MavRouter.Sharing.TransferLock
  alias Aerie.Vehicle.Command.{Refusal, Result}
  alias Aerie.Vehicle.Session.CoreProcess
  alias Aerie.Control.TransferExecutor.{Core, Job}

  @typedoc """
  A transfer: the lanes that it uses, the function that makes its machine (`t:Aerie.Control.TransferExecutor.Job.t/0`),
  its default time limit (`Aerie.Control.Transfers.time_ms/2`), and for reads a term: identical reads, which have the
  same term, share one transfer. `:details` and `:complete` are those of `c:Aerie.Control.Commands.Change.transfer/3`.
  `context.grows?`: nobody gave a time limit, so it may grow with the length that the
  vehicle reports.
  """
  @type transfer :: %{
          required(:lanes) => [Job.lane(), ...],
          required(:start) => (Job.context(), until :: integer() -> {:ok, struct()} | {:error, term()}),
          required(:timeout_ms) => pos_integer(),
          optional(:share) => term(),
          optional(:details) => (value :: term() -> map()),
          optional(:complete) => (Result.t() -> Result.t())
        }

  @typedoc """
  What a transfer reads: `{:data, offset, bytes}`, in any order and each byte once.
  """
  @type event :: {:data, non_neg_integer(), binary()}

  @doc false
  # A fault in a transfer costs the transfers under way; only one that comes again and again costs the tree a restart.
  @spec child_spec(keyword()) :: Supervisor.child_spec()
  def child_spec(arguments) do
    worker = %{id: __MODULE__, start: {__MODULE__, :start_link, [arguments]}}
    limits = [strategy: :one_for_one, max_restarts: 5, max_seconds: 10]
    %{id: __MODULE__, type: :supervisor, start: {Supervisor, :start_link, [[worker], limits]}}
  end

  @doc false
  @spec start_link(gateway: Names.gateway(), options: Aerie.Vehicle.Options.t()) :: GenServer.on_start()
  def start_link(arguments) do
    name = Names.via(arguments[:gateway], :transfers, arguments[:options].key)
    GenServer.start_link(__MODULE__, arguments, name: name)
  end

  @doc """
  Carries out a transfer, within `timeout_ms` if that is not nil. `tell` gets its progress as a command has it, `fun`
  folds what it reads; gives its result and what was folded. When the calling process ends, so does the transfer,
  unless others wait for the same. With `yields` it makes way for others.

  Errors beside those of the machines: `:vehicle_unknown`, `:vehicle_unheard`, `:vehicle_lost`, `:high_latency` (no other links reach it),
  `:full` (as many wait as may), `:taken` (one with that id is under way), `:waited` (others were under way for too long), `:yielded` (it
  made way for another one), `:lost` (the vehicle's processes were restarted).
  """
  @spec run(
          Names.gateway(),
          Store.vehicle_key(),
          id :: String.t(),
          transfer(),
          [timeout_ms: pos_integer() | nil, yields: boolean()],
          (map() -> term()),
          acc,
          (event(), acc -> acc)
        ) :: {term(), acc}
        when acc: term()
  def run(gateway, key, id, transfer, options, tell, acc, fun) do
    until = System.monotonic_time(:microsecond) + (options[:timeout_ms] || transfer.timeout_ms) * 1000

    job = %Job{
      id: id,
      lanes: transfer.lanes,
      start: &transfer.start.(Map.put(&1, :grows?, options[:timeout_ms] == nil), until),
      until: until,
      share: transfer[:share],
      yields: Keyword.get(options, :yields, false)
    }

    case Names.whereis(gateway, :transfers, key) do
      nil ->
        {{:error, :vehicle_unknown}, acc}

      pid ->
        ref = Process.monitor(pid)
        send(pid, {:submit, self(), ref, job})
        follow(ref, tell, acc, fun)
    end
  end

  defp follow(ref, tell, acc, fun) do
    receive do
      {^ref, {:done, result}} ->
        Process.demonitor(ref, [:flush])
        {result, acc}

      {^ref, {:progress, progress}} ->
        tell.(plain(progress))
        follow(ref, tell, acc, fun)

      {^ref, event} ->
        follow(ref, tell, fun.(event, acc), fun)

      {:DOWN, ^ref, :process, _pid, _reason} ->
        {{:error, :lost}, acc}
    end
  end

  # `progress` (0..1 or nil) and `text` as the progress of commands has them, with `phase`, `done` and `total`.
  defp plain({:waiting, whose}),
    do: %{
      "progress" => nil,
      "text" => "waits: " <> waits(whose),
      "phase" => "waiting",
      "done" => 0,
      "total" => nil
    }

  defp plain({done, total}), do: plain(%{phase: :reading, done: done, total: total})

  defp plain(%{phase: phase, done: done, total: total}) do
    # The size of a generated file is not known in advance.
    share = if total > 0, do: Float.round(min(done / total, 1.0), 3)

    %{
      "progress" => share,
      "text" => "#{phase}: #{done} of #{total}",
      "phase" => Atom.to_string(phase),
      "done" => done,
      "total" => total
    }
  end

  defp waits(nil), do: "another transfer with the vehicle is under way"

  defp waits({system, component}),
    do: "the ground station #{system}/#{component} has a transfer with the vehicle"

  @doc "Cancels a transfer, for all its callers."
  @spec cancel(Names.gateway(), Store.vehicle_key(), id :: String.t()) :: :ok | {:error, String.t()}
  def cancel(gateway, key, id) do
    GenServer.call(Names.via(gateway, :transfers, key), {:cancel, id})
  catch
    :exit, _gone -> {:error, Refusal.text(:no_transfer, id: id)}
  end

  @impl GenServer
  def init(gateway: gateway, options: options) do
    Process.set_label({:transfers, options.id})

    {:ok,
     %{
       gateway: gateway,
       options: options,
       core: Core.new(),
       watchers: %{},
       listening: nil,
       turns: nil,
       timer: nil
     }}
  end

  @impl GenServer
  def handle_call({:cancel, id}, _from, state) do
    if Core.known?(state.core, id),
      do: {:reply, :ok, step(state, {:cancel, id, now()})},
      else: {:reply, {:error, Refusal.text(:no_transfer, id: id)}, state}
  end

  @impl GenServer
  def handle_info({:submit, pid, ref, job}, state) do
    case facts(state) do
      {:ok, facts} ->
        {core, []} = Core.handle(state.core, {:vehicle, facts})
        {core, actions} = Core.handle(core, {:submit, job, now()})
        {:noreply, submitted(%{state | core: core}, actions, {pid, ref}, job.id)}

      {:error, reason} ->
        send(pid, {ref, {:done, {:error, reason}}})
        {:noreply, state}
    end
  end

  def handle_info({:frames, frames}, state), do: {:noreply, Enum.reduce(frames, state, &receive_frame/2)}
  def handle_info({:rebooted, _boot_ms}, state), do: {:noreply, step(state, {:rebooted, now()})}

  def handle_info({:transfer_turn, _vehicle, kind}, state),
    do: {:noreply, step(state, {:turn, kind, now()})}

  def handle_info({:timeout, timer, :wake}, %{timer: {timer, _at}} = state),
    do: {:noreply, step(%{state | timer: nil}, {:tick, now()})}

  def handle_info({:transfer_wanted, _vehicle, kind}, state),
    do: {:noreply, step(state, {:wanted, kind, now()})}

  # Without the process that gives turns nobody waits for one.
  def handle_info({:DOWN, turns, :process, _pid, _reason}, %{turns: turns} = state) do
    state = %{state | turns: nil}
    {:noreply, Enum.reduce(Core.asked(state.core), state, &step(&2, {:turn, &1, now()}))}
  end

  # Nobody waits for the transfer any more.
  def handle_info({:DOWN, monitor, :process, _pid, _reason}, state) do
    case Enum.find(state.watchers, fn {_id, all} -> is_map_key(all, monitor) end) do
      {id, all} when map_size(all) == 1 ->
        {:noreply, step(%{state | watchers: Map.delete(state.watchers, id)}, {:cancel, id, now()})}

      {id, all} ->
        {:noreply, put_in(state.watchers[id], Map.delete(all, monitor))}

      nil ->
        {:noreply, state}
    end
  end

  # Snapshots, and what comes too late.
  def handle_info(_other, state), do: {:noreply, state}

  # Refused, or under way already, or new.
  defp submitted(state, [{:done, id, result}], {pid, ref}, id) do
    send(pid, {ref, {:done, result}})
    state
  end

  defp submitted(state, [{:joined, id, other}], watcher, id), do: watched(state, other, watcher)
  defp submitted(state, actions, watcher, id), do: state |> watched(id, watcher) |> acted(actions)

  defp watched(state, id, {pid, ref}) do
    watchers = Map.put(Map.get(state.watchers, id, %{}), Process.monitor(pid), {pid, ref})
    put_in(state.watchers[id], watchers)
  end

  # The vehicle as it is known now.
  defp facts(state) do
    case Store.vehicle(state.gateway, state.options.key) do
      nil ->
        {:error, :vehicle_unheard}

      %{status: :lost} ->
        {:error, :vehicle_lost}

      %{high_latency: %{only?: true}} ->
        {:error, :high_latency}

      snapshot ->
        {:ok,
         %{
           target: {state.options.system_id, snapshot.component || 1},
           us: {state.options.own_system, state.options.own_component},
           version: snapshot.mavlink_version || 2,
           protocol: Firmware.of(snapshot.autopilot),
           autopilot: snapshot.autopilot,
           capabilities: snapshot.capabilities,
           rtt_us: snapshot.clock[:rtt_us],
           links: snapshot.links
         }}
    end
  end

  defp receive_frame(frame, state) do
    with true <- frame.id in (state.listening || []),
         {:ok, message} <- MavCodec.decode(frame) do
      step(state, {:message, frame.id, message, {frame.system, frame.component}, now()})
    else
      _not_ours -> state
    end
  end

  defp step(state, event) do
    {core, actions} = Core.handle(state.core, event)
    acted(%{state | core: core}, actions)
  end

  defp acted(state, actions) do
    # Before anything is sent, so that no answer is missed.
    ids = if Core.size(state.core) > 0, do: Core.listens(state.core)
    state = CoreProcess.listen(state, ids)
    state = Enum.reduce(actions, state, &act/2)
    CoreProcess.schedule(state, Core.wake_at(state.core))
  end

  defp act({:send, messages}, state) do
    session = Names.whereis(state.gateway, :session, state.options.key)
    if session, do: send(session, {:transmit, messages})
    state
  end

  defp act({:take, kind}, state) do
    state = watch_turns(state)

    case TransferLock.take(state.gateway, state.options.key, kind) do
      :go -> step(state, {:turn, kind, now()})
      {:hold, whose} -> step(state, {:held, kind, whose})
    end
  end

  defp act({:give_back, kind}, state) do
    TransferLock.give_back(state.gateway, state.options.key, kind)
    state
  end

  defp act({:progress, id, progress}, state), do: notify(state, id, {:progress, progress})
  defp act({:data, id, offset, bytes}, state), do: notify(state, id, {:data, offset, bytes})

  defp act({:done, id, result}, state) do
    state = notify(state, id, {:done, result})
    {all, watchers} = Map.pop(state.watchers, id, %{})
    for {monitor, _watcher} <- all, do: Process.demonitor(monitor, [:flush])
    %{state | watchers: watchers}
  end

  defp notify(state, id, what) do
    for {_monitor, {pid, ref}} <- Map.get(state.watchers, id, %{}), do: send(pid, {ref, what})
    state
  end

  defp watch_turns(%{turns: nil} = state) do
    case Names.whereis(state.gateway, :transfer_lock) do
      nil -> state
      pid -> %{state | turns: Process.monitor(pid)}
    end
  end

  defp watch_turns(state), do: state
end
