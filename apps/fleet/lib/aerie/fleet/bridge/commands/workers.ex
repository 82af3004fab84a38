defmodule Aerie.Fleet.Bridge.Commands.Workers do
  @moduledoc """
  The tasks of a process that answers requests over NATS, each in its lane (`Aerie.Fleet.Bridge.Commands.Queue`). The
  process gives every message to `arrive/4`, and what it hears of its tasks to `ended/2`; a flood must cost it less than
  it costs the connection.
  """

  alias Aerie.Base.Names
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Roles.Sources
  alias Aerie.Fleet.Bridge.Commands.{Queue, Request}
  alias Aerie.Fleet.Nats

  @max_waiting 1_000

  @enforce_keys [:gateway, :tasks, :work, :queue]
  defstruct [:gateway, :tasks, :work, :queue, running: %{}, tasks_of: %{}]

  @typedoc "`work` is called in a task; the phase `:busy` means that there is no place, which is to be answered."
  @type t :: %__MODULE__{
          gateway: Names.gateway(),
          tasks: pid(),
          work: (Nats.message(), Queue.phase(), under_way :: non_neg_integer() -> term()),
          queue: Queue.t(),
          running: %{reference() => %{message: Nats.message(), phase: Queue.phase(), pid: pid()}},
          tasks_of: %{pid() => reference()}
        }

  @doc "Starts the supervisor of tasks, linked to the caller."
  @spec new(Names.gateway(), (Nats.message(), Queue.phase(), non_neg_integer() -> term())) :: t()
  def new(gateway, work) do
    {:ok, tasks} = Task.Supervisor.start_link()
    %__MODULE__{gateway: gateway, tasks: tasks, work: work, queue: Queue.new(now())}
  end

  @doc """
  A message has come. `need`: `:source` if it takes a known source, else `:nothing`; `ending?`: it holds a vehicle or
  brings it down. Dropped are those that claim nothing while many wait, those beyond the limits of their lane, and, as
  `:unread`, refused ones.
  """
  @spec arrive(t(), Nats.message(), need :: :source | :nothing, ending? :: boolean()) ::
          {:ok, t()} | {:drop, :dropped | :unread}
  def arrive(workers, message, need, ending?) do
    # The cheapest look first.
    case claim(workers, message, need) do
      :full ->
        {:drop, :dropped}

      claim ->
        {:message_queue_len, waiting} = Process.info(self(), :message_queue_len)

        if waiting > @max_waiting and not is_tuple(claim),
          do: {:drop, dropped(claim)},
          else: queue(workers, claim, message, ending?)
    end
  end

  defp queue(workers, claim, message, ending?) do
    case Queue.arrive(workers.queue, claim, message, ending?, now()) do
      :drop -> {:drop, dropped(claim)}
      {:run, phase, queue} -> {:ok, run(%{workers | queue: queue}, message, phase)}
      {:wait, queue} -> {:ok, %{workers | queue: queue}}
    end
  end

  defp dropped(:refused), do: :unread
  defp dropped(_claim), do: :dropped

  defp claim(_workers, _message, :nothing), do: :unsigned

  defp claim(workers, message, :source) do
    signature = Request.signature(message)
    now = System.os_time(:microsecond)

    with {:listed, key} = claim <- Sources.claim(Policy.Store.get(workers.gateway), signature, now) do
      cond do
        not Queue.room?(workers.queue, key) -> :full
        Sources.fresh?(signature, now) -> claim
        true -> :refused
      end
    end
  end

  @doc "A task asks whether it may continue, its message having a valid signature."
  @spec verified(t(), task :: pid(), signature :: String.t(), ending? :: boolean()) ::
          {:ok | {:busy, under_way :: non_neg_integer()}, t()}
  def verified(workers, pid, signature, ending?) do
    task = Map.fetch!(workers.tasks_of, pid)

    case Map.fetch!(workers.running, task) do
      %{phase: {:checking, key}} = entry ->
        {phase, next, queue} = Queue.verified(workers.queue, key, signature, ending?, now())
        workers = put_in(%{workers | queue: queue}.running[task], %{entry | phase: phase})
        answer = if phase, do: :ok, else: {:busy, map_size(workers.running)}
        {answer, turn(workers, next, {:checking, key})}

      # Its time or the policy changed since it was classified: it stays in its lane.
      _another_lane ->
        {:ok, workers}
    end
  end

  @doc "A task has ended. Gives its message; nil if the reference is not a task's."
  @spec ended(t(), reference()) :: {Nats.message() | nil, t()}
  def ended(%{running: running} = workers, task) when is_map_key(running, task) do
    Process.demonitor(task, [:flush])
    {entry, running} = Map.pop!(running, task)
    workers = %{workers | running: running, tasks_of: Map.delete(workers.tasks_of, entry.pid)}
    {entry.message, left(workers, entry.phase)}
  end

  def ended(workers, _other), do: {nil, workers}

  defp left(workers, nil), do: workers

  defp left(workers, phase) do
    {next, queue} = Queue.left(workers.queue, phase)
    turn(%{workers | queue: queue}, next, phase)
  end

  defp turn(workers, {:ok, message}, phase), do: run(workers, message, phase)
  defp turn(workers, :none, _phase), do: workers

  # The process never waits for the connection, which may be busy with a flood.
  defp run(%{work: work} = workers, message, phase) do
    under_way = map_size(workers.running)
    task = Task.Supervisor.async_nolink(workers.tasks, fn -> work.(message, phase, under_way) end)
    entry = %{message: message, phase: phase, pid: task.pid}

    %{
      workers
      | running: Map.put(workers.running, task.ref, entry),
        tasks_of: Map.put(workers.tasks_of, task.pid, task.ref)
    }
  end

  defp now, do: System.monotonic_time(:microsecond)
end
