defmodule Aerie.Control.CommandExecutor.Core do
  @moduledoc """
  The executor of one vehicle, without the process: `handle(core, event) -> {core, actions}`.

  A command becomes steps (`Aerie.Vehicle.Protocol`), which are carried out one after the other. One step of each key is in flight; the
  others wait, at most 64 commands in all. A safe step is sent again while no answer comes (C1), any other once.
  Nothing is sent after the deadline. Where the vehicle's state can show what a command did, it decides (`Verdict`). Each command
  gets exactly one result.

  Events, all with the time `now` in microseconds of any clock that is never set:

    * `{:submit, command, until, now}` - a command; `until` is its deadline by that clock
    * `{:cancel, id, now}`
    * `{:message, message, source, now}` - a message of the vehicle's system that `listens/1` asks for
    * `{:observed, changes, groups, now}` - its state: fields of `Aerie.Vehicle.Protocol.Vehicle`, and which groups were heard
    * `{:said, {:text | :report, words}, now}` - a warning of the vehicle, which may be the reason for a refusal
    * `{:alone, now}` - nobody else asks the vehicle by the commands that are shared, as `{:alone, true}` wanted
    * `{:rtt, us}` - the measured round trip, `:high_latency` while only such links reach the vehicle
    * `{:tick, now}` - at `wake_at/1` at the latest

  Actions, to be carried out in order:

    * `{:send, messages, id}` - to the vehicle, for the command with this id
    * `{:alone, boolean}` - our session is to send no shared command (`Aerie.Vehicle.Protocol.Step`) and to say when none is under way; or it may
      again
    * `{:result, result}` - the end of a command
    * `{:progress, id, %{"progress" => share | nil, "text" => text | nil}}`
    * `{:duplicate, id}` - a command with this id is being carried out; nothing was done
    * `{:not_cancelled, id, reason}`
  """

  alias Aerie.Vehicle.{Command, Firmware, Protocol}
  alias Aerie.Vehicle.Command.{Refusal, Result}
  alias Aerie.Vehicle.Protocol.Mavlink.Version
  alias Aerie.Vehicle.Protocol.Vehicle
  alias Aerie.Control.Policy.Intent
  alias Aerie.Control.CommandExecutor.{Job, Repeater, Steps, Timing, Turns}

  @max_jobs 64
  # More for what holds the vehicle or brings it down.
  @reserve 16
  @max_said 8

  @enforce_keys [:protocol, :vehicle]
  defstruct [
    :protocol,
    :vehicle,
    :rtt,
    alone_until: nil,
    alone: :no,
    said: [],
    jobs: %{},
    lanes: Turns.new(),
    repeater: Repeater.new()
  ]

  @type t :: %__MODULE__{
          protocol: module(),
          vehicle: Vehicle.t(),
          rtt: Timing.rtt(),
          alone: :no | :asked | :held,
          alone_until: integer() | nil,
          said: [{at :: integer(), :text | :report, String.t()}],
          jobs: %{String.t() => Job.t()},
          lanes: Turns.t(),
          repeater: Repeater.t()
        }
  @type event ::
          {:submit, Command.t(), until :: integer(), now :: integer()}
          | {:cancel, id :: String.t(), now :: integer()}
          | {:message, Protocol.message(), Protocol.source(), now :: integer()}
          | {:observed, map(), [Vehicle.group()], now :: integer()}
          | {:said, {:text | :report, String.t()}, now :: integer()}
          | {:alone, now :: integer()}
          | {:rtt, Timing.rtt()}
          | {:tick, now :: integer()}
  @type action ::
          {:send, [Protocol.message(), ...], id :: String.t()}
          | {:alone, boolean()}
          | {:result, Result.t()}
          | {:progress, id :: String.t(), map()}
          | {:duplicate, id :: String.t()}
          | {:not_cancelled, id :: String.t(), reason :: String.t()}
  @typedoc "A core and the actions so far, the latest first."
  @type acc :: {t(), [action()]}

  @doc "An executor for a vehicle."
  @spec new(Vehicle.t()) :: t()
  def new(vehicle), do: %__MODULE__{protocol: Firmware.of(vehicle.autopilot), vehicle: vehicle}

  @doc "How many commands are being carried out or wait."
  @spec size(t()) :: non_neg_integer()
  def size(core), do: map_size(core.jobs)

  @doc "The ids of the messages that have to be handed over now."
  @spec listens(t()) :: [non_neg_integer()]
  def listens(core) do
    for({_id, job} <- core.jobs, Job.sent?(job), id <- core.protocol.listens(Job.step(job)), do: id)
    |> Enum.uniq()
  end

  @doc "When the next `:tick` is due; nil while there is nothing to wait for."
  @spec wake_at(t()) :: integer() | nil
  def wake_at(core) do
    dues = for {_id, job} <- core.jobs, do: if(job.phase == :queued, do: job.until, else: job.due)
    times = [core.alone_until, Repeater.next_at(core.repeater) | Turns.wakes(core.lanes)] ++ dues
    times |> Enum.reject(&is_nil/1) |> Enum.min(fn -> nil end)
  end

  @doc "Deals with an event."
  @spec handle(t(), event()) :: {t(), [action()]}
  def handle(core, event) do
    {core, actions} = event({core, []}, event)
    {core, Enum.reverse(actions)}
  end

  defp event({core, actions}, {:submit, %{id: id}, _until, _now}) when is_map_key(core.jobs, id),
    do: {core, [{:duplicate, id} | actions]}

  defp event({core, actions}, {:submit, command, until, now}) do
    cond do
      now >= until ->
        refuse({core, actions}, command, Refusal.ended(:expired))

      map_size(core.jobs) >= most(command) ->
        refuse({core, actions}, command, Refusal.ended(:waiting_many, n: most(command)))

      true ->
        planned({core, actions}, command, until, now)
    end
  end

  defp event({core, _actions} = acc, {:cancel, id, now}) do
    case core.jobs do
      %{^id => job} -> cancel(acc, job, now)
      _other -> cancel_stream(acc, id)
    end
  end

  defp event(acc, {:message, message, source, now}) do
    Steps.each(acc, &Job.sent?/1, fn {core, _actions} = acc, job ->
      Steps.answer(acc, job, core.protocol.read(Job.step(job), message, source, core.vehicle), now)
    end)
    |> Steps.turns(now)
  end

  defp event({core, actions}, {:observed, changes, groups, now}) do
    seen = Enum.reduce(groups, core.vehicle.seen, &Map.put(&2, &1, now))
    vehicle = struct!(core.vehicle, Map.put(changes, :seen, seen))
    rebooted? = vehicle.boots > core.vehicle.boots
    acc = {%{core | vehicle: vehicle}, actions}

    acc = Steps.each(acc, &Job.sent?/1, &Steps.observe(&1, &2, now))
    if(rebooted?, do: Steps.rebooted(acc, now), else: acc) |> Steps.turns(now)
  end

  defp event({core, actions}, {:said, {kind, words}, now}) do
    acc = {%{core | said: Enum.take([{now, kind, words} | core.said], @max_said)}, actions}
    Steps.each(acc, &(&1.phase == :refused), &Steps.explained(&1, &2, kind, now))
  end

  defp event({core, actions}, {:alone, now}),
    do: Steps.alone({%{core | alone: :held}, actions}, now) |> Steps.turns(now)

  defp event({core, actions}, {:rtt, us}), do: {%{core | rtt: us}, actions}

  defp event(acc, {:tick, now}) do
    acc
    |> Steps.each(&Steps.due?(&1, now), &Steps.due(&1, &2, now))
    |> repeat(now)
    |> Steps.turns(now)
  end

  # --- A new command

  defp planned({core, actions}, command, until, now) do
    case Protocol.plan(core.protocol, command, core.vehicle) do
      {:ok, [%{stream: %{}} = step]} ->
        case Version.refusal(core.protocol.encode(step, 0, core.vehicle), core.vehicle.version) do
          nil -> stream({core, actions}, command, step, until, now)
          reason -> refuse({core, actions}, command, {:rejected, reason})
        end

      {:ok, steps} ->
        job = %Job{command: command, until: until, steps: steps, since: now, mode: core.vehicle.mode}

        {job, {core, actions}} =
          if hd(steps).urgent?, do: seize({core, actions}, job, now), else: {job, {core, actions}}

        core = Steps.put(core, job)
        Steps.turns({%{core | lanes: Turns.push(core.lanes, Job.key(job), Job.id(job))}, actions}, now)

      {_gap_or_error, reason} ->
        refuse({core, actions}, command, {:rejected, reason})
    end
  end

  # The replaced command is abandoned, because the next acknowledgement cannot be attributed.
  defp seize({core, actions}, job, now) do
    {quiet?, ids, lanes} = Turns.seize(core.lanes, Job.key(job))
    {:unknown, reason} = replaced = Refusal.ended(:replaced, command: job.command.type)
    ambiguous? = quiet? or Enum.any?(ids, &awaited?(core, Map.fetch!(core.jobs, &1), now))

    {core, actions} =
      Enum.reduce(ids, {core, actions}, fn id, {core, _actions} = acc ->
        case Map.fetch!(core.jobs, id) do
          %{phase: :refused} = other -> Steps.finish(acc, other, other.refusal, now)
          %{sends: 0} = other -> Steps.finish(acc, other, {:cancelled, reason}, now)
          other -> Steps.finish(acc, other, replaced, now)
        end
      end)

    {%{job | ambiguous?: ambiguous?}, {%{core | lanes: lanes}, actions}}
  end

  # Whether an answer to it may still come.
  defp awaited?(core, job, now),
    do: Job.sent?(job) and (job.accepted_at == nil or now < job.accepted_at + Timing.quiet(core.rtt))

  defp most(command), do: if(Intent.of(command).ends_flight?, do: @max_jobs + @reserve, else: @max_jobs)

  defp refuse({core, actions}, command, {status, reason}) do
    details = %{"ms" => 0, "sent" => 0, "acknowledged" => false}
    {core, [{:result, Result.new(command.id, status, reason, details)} | actions]}
  end

  # --- Cancelling

  defp cancel(acc, %{phase: phase} = job, now) when phase in [:queued, :turn],
    do: acc |> Steps.finish(job, Refusal.ended(:cancelled_waiting), now) |> Steps.turns(now)

  defp cancel(acc, %{phase: :refused} = job, now),
    do: acc |> Steps.finish(job, job.refusal, now) |> Steps.turns(now)

  defp cancel({core, actions} = acc, job, now) do
    case core.protocol.cancel(Job.step(job), core.vehicle) do
      [] ->
        {core, [{:not_cancelled, Job.id(job), Refusal.text(:not_cancellable)} | actions]}

      {:error, reason} ->
        {core, [{:not_cancelled, Job.id(job), reason} | actions]}

      messages ->
        # Where it is cancelled by the command itself, the answers to both look alike.
        ambiguous? = job.ambiguous? or Job.step(job).cancel != nil

        job = %{
          job
          | phase: :cancelling,
            ambiguous?: ambiguous?,
            cancels: 1,
            due: now + Timing.cancel(core.rtt)
        }

        Steps.send_cancel(acc, job, messages, now)
    end
  end

  # --- Streams

  defp stream({core, actions}, command, step, until, now) do
    {repeater, given_back} = Repeater.start(core.repeater, command, step, until, now)
    note = if step.note, do: "; " <> step.note, else: ""
    {status, reason} = Refusal.ended(:repeated, hz: step.stream.hz, ms: step.stream.ms, note: note)
    details = %{"ms" => 0, "sent" => 1, "acknowledged" => false}
    result = {:result, Result.new(command.id, status, reason, details)}

    {core, actions} = release({%{core | repeater: repeater}, actions}, given_back)
    {core, actions} = repeat({core, actions}, now)
    {core, [result | actions]}
  end

  defp repeat({core, actions}, now) do
    case Repeater.tick(core.repeater, now) do
      {:send, id, step, repeater} ->
        messages = core.protocol.encode(step, 0, core.vehicle)
        {%{core | repeater: repeater}, [{:send, messages, id} | actions]}

      {:end, ended, repeater} ->
        release({%{core | repeater: repeater}, actions}, ended)

      :wait ->
        {core, actions}
    end
  end

  defp release(acc, nil), do: acc

  defp release({core, actions}, {id, step}) do
    case core.protocol.release(step, core.vehicle) do
      [] -> {core, actions}
      messages -> {core, [{:send, messages, id} | actions]}
    end
  end

  defp cancel_stream({core, actions}, id) do
    case Repeater.stop(core.repeater, id) do
      {ended, repeater} -> release({%{core | repeater: repeater}, actions}, ended)
      nil -> {core, [{:not_cancelled, id, Refusal.text(:no_such_command)} | actions]}
    end
  end
end
