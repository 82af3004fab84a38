defmodule Aerie.Control.CommandExecutor do
  @moduledoc """
  The process that carries out the commands of one vehicle: `Aerie.Control.CommandExecutor.Core` with a clock and a way to the vehicle.

  It sends through the vehicle's session, which has our sequence numbers and the path. Only while a command is carried out does
  the session hand over what the executor wants to see: frames with some ids, its snapshots, texts, reports and reboots. It dies with the
  session; the result of a command that was in flight then is `unknown`, and it is not sent again.
  """
  use GenServer

  import Aerie.Vehicle.Session.CoreProcess, only: [now: 0]

  alias Aerie.Base.{Names, Store}
  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.{Refusal, Result}
  alias Aerie.Vehicle.Session.CoreProcess
  alias Aerie.Control.CommandExecutor.{Core, Observed}
  alias MavCodec.Messages.Statustext

  # MAV_SEVERITY: a reason for a refusal is no less than that.
  @warning 4

  @doc false
  @spec start_link(gateway: Names.gateway(), options: Aerie.Vehicle.Options.t()) :: GenServer.on_start()
  def start_link(arguments) do
    name = Names.via(arguments[:gateway], :commands, arguments[:options].key)
    GenServer.start_link(__MODULE__, arguments, name: name)
  end

  @doc """
  Carries out a command and waits for its result, until `command.deadline` and for as long as the vehicle may then need to
  answer. With `progress: pid` that process gets `{:command_progress, id, %{"progress" => share, "text" => text}}`. `still?` is asked before
  each message whether this gateway may still send; if not, no more is sent, and the result is `unknown`.

  Nothing here asks whether the source may do it.
  """
  @spec submit(Names.gateway(), Store.vehicle_key(), Command.t(),
          progress: pid(),
          still?: (-> boolean()) | nil
        ) :: Result.t()
  def submit(gateway, key, command, options \\ []),
    do: call(gateway, key, command.id, {:submit, command, options[:progress], options[:still?]})

  @doc "Cancels a command; its submitter gets the result. `:error` if it cannot be cancelled."
  @spec cancel(Names.gateway(), Store.vehicle_key(), id :: String.t()) :: :ok | {:error, reason :: String.t()}
  def cancel(gateway, key, id) do
    case call(gateway, key, id, {:cancel, id}) do
      %Result{reason: reason} -> {:error, reason}
      answer -> answer
    end
  end

  defp call(gateway, key, id, request) do
    case Names.whereis(gateway, :commands, key) do
      nil -> Refusal.result(id, Refusal.ended(:vehicle_unknown))
      pid -> GenServer.call(pid, request, :infinity)
    end
  catch
    :exit, _reason -> Refusal.result(id, Refusal.ended(:lost))
  end

  @impl GenServer
  def init(gateway: gateway, options: options) do
    Process.set_label({:commands, options.id})

    {:ok,
     %{
       gateway: gateway,
       options: options,
       core: nil,
       sources: %{},
       callers: %{},
       stream: nil,
       listening: nil,
       timer: nil
     }}
  end

  @impl GenServer
  def handle_call({:submit, command, progress, still?}, from, state) do
    case ready(state) do
      {:ok, state} ->
        now = now()
        # By our own clock from here on: the machine's may be set meanwhile.
        until = now + command.deadline - System.os_time(:microsecond)
        known? = is_map_key(state.callers, command.id)
        state = if known?, do: state, else: put_in(state.callers[command.id], {from, progress, still?})
        {:noreply, step(state, {:submit, command, until, now}, from)}

      refused ->
        {:reply, Refusal.result(command.id, refused), state}
    end
  end

  def handle_call({:cancel, id}, _from, %{core: nil} = state),
    do: {:reply, {:error, Refusal.text(:no_command, id: id)}, state}

  def handle_call({:cancel, id}, from, state) do
    {core, actions} = Core.handle(state.core, {:cancel, id, now()})
    refusal = for {:not_cancelled, ^id, reason} <- actions, do: reason
    GenServer.reply(from, if(refusal == [], do: :ok, else: {:error, hd(refusal)}))
    {:noreply, acted(%{state | core: core}, actions, nil)}
  end

  @impl GenServer
  def handle_info({:frames, frames}, state) do
    state =
      Enum.reduce(frames, state, fn frame, state ->
        case MavCodec.decode(frame) do
          {:ok, message} -> step(state, {:message, message, {frame.system, frame.component}, now()})
          {:error, _unknown} -> state
        end
      end)

    {:noreply, state}
  end

  def handle_info({:snapshot, snapshot}, state), do: {:noreply, observe(state, snapshot, %{})}

  def handle_info({:text, %{severity: severity, text: text}}, %{core: %Core{} = core} = state) do
    now = now()
    source = {core.vehicle.system, core.vehicle.component}
    state = step(state, {:message, %Statustext{severity: severity, text: text}, source, now})
    {:noreply, if(severity <= @warning, do: step(state, {:said, {:text, text}, now}), else: state)}
  end

  def handle_info({:reported, %{severity: severity, name: "commander_" <> words}}, %{core: %Core{}} = state)
      when severity <= @warning,
      do: {:noreply, step(state, {:said, {:report, String.replace(words, "_", " ")}, now()})}

  def handle_info(:alone, state), do: {:noreply, step(state, {:alone, now()})}

  def handle_info({:rebooted, boot_ms}, %{core: %Core{} = core} = state) do
    now = now()
    booted = %{boots: core.vehicle.boots + 1, booted_at: now - (boot_ms || 0) * 1000}
    {:noreply, step(state, {:observed, booted, [], now})}
  end

  def handle_info({:timeout, timer, :wake}, %{timer: {timer, _at}} = state),
    do: {:noreply, step(%{state | timer: nil}, {:tick, now()})}

  # A timer that was cancelled too late, or a frame that came after the last command.
  def handle_info(_late, state), do: {:noreply, state}

  # The vehicle as it is known now.
  defp ready(state) do
    case Store.vehicle(state.gateway, state.options.key) do
      nil ->
        Refusal.ended(:vehicle_unheard)

      %{status: :lost} ->
        Refusal.ended(:vehicle_lost)

      %{autopilot: autopilot} = snapshot ->
        us = {state.options.own_system, state.options.own_component}
        protocol = Aerie.Vehicle.Firmware.of(autopilot)
        known? = state.core != nil and state.core.protocol == protocol
        core = if known?, do: state.core, else: Core.new(Observed.vehicle(snapshot, us))
        {:ok, observe(%{state | core: core}, snapshot, %{})}
    end
  end

  defp observe(%{core: nil} = state, _snapshot, _more), do: state

  defp observe(state, snapshot, more) do
    sources = Observed.sources(snapshot)
    groups = Observed.changed_groups(state.sources, sources)
    state = rtt(%{state | sources: sources}, snapshot)
    step(state, {:observed, Map.merge(Observed.changes(snapshot), more), groups, now()})
  end

  defp rtt(%{core: %{rtt: before}} = state, snapshot) do
    rtt =
      case snapshot do
        %{high_latency: %{only?: true}} -> :high_latency
        %{clock: %{rtt_us: us}} when is_integer(us) -> us
        _unmeasured -> if before == :high_latency, do: nil, else: before
      end

    {core, []} = Core.handle(state.core, {:rtt, rtt})
    %{state | core: core}
  end

  defp step(state, event, from \\ nil)
  defp step(%{core: nil} = state, _event, _from), do: state

  defp step(state, event, from) do
    {core, actions} = Core.handle(state.core, event)
    acted(%{state | core: core}, actions, from)
  end

  defp acted(state, actions, from) do
    # Before anything is sent, so that no answer is missed.
    ids = if Core.size(state.core) > 0, do: [:snapshots | Core.listens(state.core)]
    state = CoreProcess.listen(state, ids)
    state = Enum.reduce(actions, state, &act(&1, &2, from))
    CoreProcess.schedule(state, Core.wake_at(state.core))
  end

  defp act({:send, messages, id}, state, _from) do
    case state do
      %{callers: %{^id => {from, _progress, still?}}} when still? != nil ->
        if still?.(), do: transmit(state, messages), else: withheld(state, id, from)

      # A set-point is repeated after its result.
      %{stream: {^id, still?}} ->
        if still?.(), do: transmit(state, messages), else: state

      _anybody ->
        transmit(state, messages)
    end
  end

  defp act({:alone, wanted?}, state, _from) do
    session = Names.whereis(state.gateway, :session, state.options.key)
    if session, do: send(session, {:alone, self(), wanted?})
    state
  end

  defp act({:result, result}, state, _from) do
    case Map.pop(state.callers, result.id) do
      {{from, _progress, still?}, callers} ->
        if from, do: GenServer.reply(from, result)
        stream(%{state | callers: callers}, result.id, still?)

      {nil, _callers} ->
        state
    end
  end

  defp act({:progress, id, progress}, state, _from) do
    case state.callers do
      %{^id => {_from, pid, _still}} when is_pid(pid) -> send(pid, {:command_progress, id, progress})
      _nobody -> :ok
    end

    state
  end

  defp act({:duplicate, id}, state, from) do
    GenServer.reply(from, Refusal.result(id, Refusal.ended(:carried_out)))
    state
  end

  defp act({:not_cancelled, _id, _reason}, state, _from), do: state

  defp stream(%{core: %{repeater: %{id: id}}} = state, id, still?) when still? != nil,
    do: %{state | stream: {id, still?}}

  defp stream(state, _id, _still?), do: state

  defp transmit(state, messages) do
    session = Names.whereis(state.gateway, :session, state.options.key)
    if session, do: send(session, {:transmit, messages})
    state
  end

  # Its job ends without a message; waiting callers get the result now.
  defp withheld(state, _id, nil), do: state

  defp withheld(state, id, from) do
    GenServer.reply(from, Refusal.result(id, Refusal.ended(:holder_changed)))
    put_in(state.callers[id], {nil, nil, fn -> false end})
  end
end
