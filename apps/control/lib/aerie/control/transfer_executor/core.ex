defmodule Aerie.Control.TransferExecutor.Core do
  @moduledoc """
  The transfers of one vehicle, without the process: `handle(core, event) -> {core, actions}`.

  Each lane (`t:Aerie.Control.TransferExecutor.Job.lane/0`) has one transfer under way; the others wait in the order
  of their arrival, at most 32 in all. Before a transfer of missions, files or logs begins, it takes its turn among
  those of ground stations. One that yields (`t:Aerie.Control.TransferExecutor.Job.t/0`) goes out of the way of
  others, and of a ground station that wants the turn.

  Events, with the time `now` in microseconds of a clock that is never set:

    * `{:submit, job, now}` - a transfer
    * `{:cancel, id, now}`
    * `{:turn, kind, now}` - it is our turn; `{:held, kind, whose}` - it is that of a ground station, whose ids are
      given, or nil
    * `{:wanted, kind, now}` - a ground station waits for our turn
    * `{:message, id, message, source, now}` - a message of the vehicle's system, with its MAVLink id
    * `{:vehicle, facts}` - what is known of the vehicle: the fields of
      `t:Aerie.Control.TransferExecutor.Job.context/0` but `seq`, `ftp?` and `now`
    * `{:rebooted, now}` - the vehicle has rebooted
    * `{:tick, now}` - at `wake_at/1` at the latest

  Actions, to be carried out in order:

    * `{:send, messages}`
    * `{:take, kind}` - asks for the turn; `{:turn, …}` or `{:held, …}` is the answer; `{:give_back, kind}`
    * `{:progress, id, progress}` - the machine's words: `{done, total}` or the map of `Protocols.Mission.Transfer`; or
      `{:waiting, whose}`
    * `{:data, id, offset, bytes}` - a piece of a file or log
    * `{:joined, id, other}` - this transfer is the same as that one, whose end is its end too
    * `{:done, id, result}` - the end: what the machine gave, or `{:error, :full | :taken | :waited | :cancelled}` for
      one that did not begin, `{:error, :yielded}`
  """

  alias MavRouter.Sharing.TransferLock
  alias Aerie.Control.TransferExecutor.Job
  alias Aerie.Vehicle.Protocol.Mavlink.Version
  alias MavCodec.Messages, as: M

  @max_jobs 32
  # How long a transfer waits for others.
  @wait_us 60_000_000

  @listens %{
    params: [M.ParamValue, M.ParamExtValue, M.ParamExtAck, M.ParamError, M.ComponentMetadata],
    mission:
      [M.MissionRequest, M.MissionRequestInt, M.MissionCount, M.MissionItemInt, M.MissionAck] ++
        [M.MissionCurrent, M.Event, M.Statustext],
    file: [M.FileTransferProtocol],
    log: [M.LogEntry, M.LogData]
  }
  @ids Map.new(@listens, fn {lane, modules} -> {lane, Enum.map(modules, & &1.id())} end)

  defstruct vehicle: nil, seq: 0, silent: nil, jobs: %{}, order: []

  @typedoc """
  `silent`: the links by which FTP was not answered; until the vehicle reboots or answers, it is not asked
  for parameters by them
  """

  @type t :: %__MODULE__{
          vehicle: map() | nil,
          seq: 0..65_535,
          silent: [term()] | nil,
          jobs: %{String.t() => Job.t()},
          order: [String.t()]
        }
  @type event ::
          {:submit, Job.t(), integer()}
          | {:wanted, TransferLock.kind(), integer()}
          | {:cancel, String.t(), integer()}
          | {:turn, TransferLock.kind(), integer()}
          | {:held, TransferLock.kind(), {non_neg_integer(), 0..255} | nil}
          | {:message, non_neg_integer(), struct(), {non_neg_integer(), 0..255}, integer()}
          | {:vehicle, map()}
          | {:rebooted | :tick, integer()}
  @type action ::
          {:send, [struct(), ...]}
          | {:take | :give_back, TransferLock.kind()}
          | {:progress, String.t(), {non_neg_integer(), non_neg_integer()} | map() | {:waiting, term()}}
          | {:data, String.t(), non_neg_integer(), binary()}
          | {:joined, String.t(), String.t()}
          | {:done, String.t(), term()}

  @doc "No transfers."
  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "How many are under way or wait."
  @spec size(t()) :: non_neg_integer()
  def size(core), do: map_size(core.jobs)

  @doc "Whether a transfer is under way or waits."
  @spec known?(t(), String.t()) :: boolean()
  def known?(core, id), do: is_map_key(core.jobs, id)

  @doc "The turns that are waited for."
  @spec asked(t()) :: [TransferLock.kind()]
  def asked(core), do: for({_id, job} <- core.jobs, kind <- job.asked, do: kind)

  @doc "The ids of the messages that have to be handed over now."
  @spec listens(t()) :: [non_neg_integer()]
  def listens(core) do
    for(job <- running(core), lane <- job.lanes, id <- @ids[lane], do: id) |> Enum.uniq()
  end

  @doc "When the next `:tick` is due; nil while there is nothing to wait for."
  @spec wake_at(t()) :: integer() | nil
  def wake_at(core), do: core.jobs |> Enum.map(fn {_id, job} -> due(job) end) |> Enum.min(fn -> nil end)

  # nil is greater than any number.
  defp due(%{phase: :running, machine: %module{} = machine}), do: module.wake_at(machine)
  defp due(job), do: job.start_by

  @doc "Deals with an event."
  @spec handle(t(), event()) :: {t(), [action()]}
  def handle(core, {:vehicle, facts}), do: {%{core | vehicle: facts}, []}

  def handle(core, {:submit, %{id: id}, _now}) when is_map_key(core.jobs, id),
    do: {core, [{:done, id, {:error, :taken}}]}

  def handle(core, {:submit, job, now}) do
    same = job.share && Enum.find_value(core.jobs, fn {id, other} -> other.share == job.share && id end)

    cond do
      same -> {joined(core, core.jobs[same], job), [{:joined, job.id, same}]}
      size(core) >= @max_jobs and not yields_to?(core, job) -> {core, [{:done, job.id, {:error, :full}}]}
      true -> core |> make_way(job.lanes, not job.yields, now) |> queued(job, now) |> next(now)
    end
  end

  def handle(core, {:wanted, kind, now}), do: core |> make_way([kind], true, now) |> next(now)

  def handle(core, {:cancel, id, now}) do
    case core.jobs do
      %{^id => %{phase: :running} = job} -> core |> step(job, {:cancel, now}, now) |> next(now)
      %{^id => job} -> core |> finish(job, {:error, :cancelled}) |> next(now)
      _unknown -> {core, []}
    end
  end

  def handle(core, {:turn, kind, now}) do
    case Enum.find(Map.values(core.jobs), &(kind in &1.asked)) do
      nil ->
        {core, [{:give_back, kind}]}

      job ->
        job = %{job | asked: List.delete(job.asked, kind), turns: [kind | job.turns]}
        core = put(core, job)
        if job.asked == [], do: core |> begin(job, now) |> next(now), else: {core, []}
    end
  end

  def handle(core, {:held, kind, whose}) do
    {core, for({id, job} <- core.jobs, kind in job.asked, do: {:progress, id, {:waiting, whose}})}
  end

  def handle(core, {:message, message_id, message, source, now}) do
    core
    |> each(&hears?(&1, message_id), fn core, job ->
      step(core, job, {:message, message, source, now}, now)
    end)
    |> next(now)
  end

  def handle(core, {:rebooted, now}),
    do: %{core | silent: nil} |> each(& &1.machine, &step(&1, &2, {:rebooted, now}, now)) |> next(now)

  def handle(core, {:tick, now}) do
    core
    |> each(&(due(&1) <= now), fn
      core, %{phase: :running} = job -> step(core, job, {:tick, now}, now)
      core, job -> finish(core, job, {:error, :waited})
    end)
    |> next(now)
  end

  defp hears?(job, message_id), do: job.phase == :running and Enum.any?(job.lanes, &(message_id in @ids[&1]))

  defp running(core), do: for({_id, %{phase: :running} = job} <- core.jobs, do: job)

  defp each(core, which, fun) do
    for {id, job} <- core.jobs, which.(job), reduce: {core, []} do
      {core, actions} ->
        {core, more} = fun.(core, Map.fetch!(core.jobs, id))
        {core, actions ++ more}
    end
  end

  # --- Waiting

  defp queued({core, actions}, job, now) do
    job = %{job | start_by: min(job.until, now + @wait_us)}
    {%{put(core, job) | order: core.order ++ [job.id]}, actions}
  end

  # Both callers wait for one transfer.
  defp joined(core, same, job), do: put(core, %{same | yields: same.yields and job.yields})

  defp make_way(core, _lanes, false, _now), do: {core, []}
  defp make_way(core, lanes, true, now), do: each(core, &in_the_way?(&1, lanes), &give_way(&1, &2, now))

  # The vehicle learns that nobody reads any more.
  defp give_way(core, %{phase: :running, id: id} = job, now) do
    {core, actions} = step(core, job, {:cancel, now}, now)
    {core, Enum.map(actions, &with({:done, ^id, _result} <- &1, do: {:done, id, {:error, :yielded}}))}
  end

  defp give_way(core, job, _now), do: finish(core, job, {:error, :yielded})

  defp in_the_way?(job, lanes), do: job.yields and Enum.any?(job.lanes, &(&1 in lanes))

  defp yields_to?(core, job),
    do: not job.yields and Enum.any?(core.jobs, fn {_id, other} -> in_the_way?(other, job.lanes) end)

  # A job begins when it has no lane in common with those before it.
  defp next({core, actions}, now) do
    taken = for {_id, %{phase: phase} = job} <- core.jobs, phase != :queued, lane <- job.lanes, do: lane

    case find(core.order, core.jobs, taken) do
      nil ->
        {core, actions}

      job ->
        core = %{core | order: List.delete(core.order, job.id)}
        {core, more} = ask(core, job, now)
        next({core, actions ++ more}, now)
    end
  end

  defp find([], _jobs, _taken), do: nil

  defp find([id | rest], jobs, taken) do
    job = Map.fetch!(jobs, id)
    if Enum.any?(job.lanes, &(&1 in taken)), do: find(rest, jobs, job.lanes ++ taken), else: job
  end

  defp ask(core, job, now) do
    case Job.kinds(job) do
      [] ->
        begin(core, job, now)

      kinds ->
        {put(core, %{job | phase: :turn, asked: kinds}), for(kind <- kinds, do: {:take, kind})}
    end
  end

  # --- Under way

  defp begin(core, job, now) do
    ftp? = core.silent == nil or core.silent != core.vehicle.links

    case job.start.(Map.merge(core.vehicle, %{seq: core.seq, ftp?: ftp?, now: now})) do
      {:ok, %module{} = machine} ->
        {machine, said} = module.handle(machine, {:start, now})
        first = for {:send, messages} <- said, message <- List.wrap(messages), do: message

        # Later on, the session keeps back what this version does not have.
        case Version.refusal(first, core.vehicle.version) do
          nil -> acted(core, %{job | phase: :running, machine: machine}, said)
          reason -> finish(core, job, {:error, reason})
        end

      {:error, reason} ->
        finish(core, job, {:error, reason})
    end
  end

  defp step(core, %{machine: %module{} = machine} = job, event, _now) do
    {machine, said} = module.handle(machine, event)
    acted(core, %{job | machine: machine}, said)
  end

  defp acted(core, job, said), do: Enum.reduce(said, {put(core, job), []}, &act(&1, &2, job))

  defp act({:send, messages}, {core, actions}, _job), do: {core, actions ++ [{:send, List.wrap(messages)}]}

  defp act({:data, offset, bytes}, {core, actions}, job),
    do: {core, actions ++ [{:data, job.id, offset, bytes}]}

  defp act({:progress, done, total}, {core, actions}, job),
    do: {core, actions ++ [{:progress, job.id, {done, total}}]}

  defp act({:progress, progress}, {core, actions}, job),
    do: {core, actions ++ [{:progress, job.id, progress}]}

  defp act({ended, result}, {core, actions}, job) when ended in [:done, :result] do
    {core, more} = finish(core, job, result)
    {core, actions ++ more}
  end

  defp finish(core, job, result) do
    core = %{core | jobs: Map.delete(core.jobs, job.id), order: List.delete(core.order, job.id)}

    {seq_of(core, job),
     for(kind <- job.turns ++ job.asked, do: {:give_back, kind}) ++ [{:done, job.id, result}]}
  end

  defp seq_of(core, %{machine: %module{} = machine, lanes: lanes}) do
    if :file in lanes,
      do: %{core | seq: module.seq(machine), silent: silent(module.heard?(machine), core)},
      else: core
  end

  defp seq_of(core, _not_begun), do: core

  defp silent(true, _core), do: nil
  defp silent(false, core), do: core.vehicle.links
  defp silent(nil, core), do: core.silent

  defp put(core, job), do: %{core | jobs: Map.put(core.jobs, job.id, job)}
end
