defmodule Aerie.Control.Policy.Audit do
  @moduledoc """
  The audit log of a gateway: every decision about a command and every result, in a chain of records on disk
  (`Aerie.Control.Policy.Audit.Log`), written by this process.

  When it cannot be written (a full disk, a folder that is gone), `append/3` says so, and `verdict/3` says what follows:
  with `required: true`, the default, commands are denied until it can be again, but for those that hold a vehicle or
  bring it down. A task brings it to the disk once a second, so that no caller waits for a slow one. Records that could
  not be written are counted, shown by `status/1`, and noted in the log itself as soon as it can be written.

  Telemetry: `[:aerie, :audit, :failing]` (`count` 1; `gateway`, `reason`) when writing begins to fail, and
  `[:aerie, :audit, :writing]` (`missed`; `gateway`) when it works again.
  """

  use GenServer

  alias Aerie.Base.{Names, Store}
  alias Aerie.Base.Files.{Damaged, Disk, FolderLock}
  alias Aerie.Control.Policy.Audit.{Log, Reader, Refusals, Verify}
  alias Aerie.Control.Policy.{Intent, Roles}
  alias Aerie.Vehicle.Command.Refusal

  require Logger

  @sync_ms 1_000
  @retry_ms 1_000
  @refusals_ms 60_000
  @call_ms 5_000
  # Notes of forwarding processes that wait at most; each is some hundred bytes.
  @max_waiting 1_000

  @typedoc """
    * `:gateway` - whose log it is; `:dir` - its folder
    * `:max_bytes` - the most that it may take on the disk; the oldest records make room
    * `:sync` - brings a file to the disk; for tests of a slow one
  """
  @type option ::
          {:gateway, Names.gateway()}
          | {:dir, Path.t()}
          | {:max_bytes, pos_integer()}
          | {:sync, (Path.t() -> :ok | {:error, File.posix()})}

  @type status :: %{
          n: non_neg_integer() | nil,
          hash: String.t() | nil,
          bytes: non_neg_integer() | nil,
          dir: Path.t(),
          failing: String.t() | nil,
          missed: non_neg_integer()
        }

  @spec start_link([option()]) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :audit))

  @doc "Writes an entry: plain values by text keys, with a `type`. It survives a kill of the program from now on."
  @spec append(Names.gateway(), %{String.t() => term()}, timeout :: pos_integer()) ::
          {:ok, n :: pos_integer()} | {:error, String.t()}
  def append(gateway, entry, timeout \\ @call_ms), do: call(gateway, {:append, entry}, timeout)

  @doc """
  The same for a caller that must not wait: a forwarding process. Where the log cannot keep up, the entry is not written
  and counts as missed. `failing/1` tells beforehand whether it can be written.
  """
  @spec note(Names.gateway(), %{String.t() => term()} | {:refusal, %{String.t() => term()}}) :: :ok
  def note(gateway, entry) do
    case Names.whereis(gateway, :audit) do
      nil ->
        :ok

      pid ->
        {:message_queue_len, waiting} = Process.info(pid, :message_queue_len) || {:message_queue_len, 0}
        GenServer.cast(pid, if(waiting < @max_waiting, do: {:note, entry}, else: :missed))
    end
  end

  @doc """
  A refusal, for callers that must not wait. Those of somebody who may nothing are counted and summed up
  (`Aerie.Control.Policy.Audit.Refusals`), by their rule or another word.
  """
  @spec refusal(Names.gateway(), Roles.source() | nil, Refusal.denial() | atom(), %{String.t() => term()}) ::
          :ok
  def refusal(gateway, source, {:deny, rule, reason}, entry) do
    denied = %{"decision" => "deny", "rule" => rule, "reason" => reason}
    refusal(gateway, source, rule, Map.merge(entry, denied))
  end

  def refusal(gateway, source, rule, entry) do
    if Refusals.nobody?(source) do
      now = System.monotonic_time(:microsecond)

      for entry <- Refusals.add(gateway, source && source.name, rule, entry, now),
          do: note(gateway, {:refusal, entry})

      :ok
    else
      note(gateway, entry)
    end
  end

  @doc "Why the log cannot be written just now, nil when it can be, without asking its process."
  @spec failing(Names.gateway()) :: String.t() | nil
  def failing(gateway), do: Names.value(gateway, :audit)

  @doc """
  Number and hash of the last record, the folder and its bytes on the disk, and why it cannot be written (nil when it
  can). Keep number and hash elsewhere to be able to prove that nothing was cut off.
  """
  @spec status(Names.gateway()) :: {:ok, status()} | {:error, String.t()}
  def status(gateway), do: call(gateway, :status)

  @doc "Whether a command may go on, given the result of recording its decision."
  @spec verdict({:ok, pos_integer()} | {:error, String.t()}, Intent.t(), required? :: boolean()) ::
          :allow | Refusal.denial()
  def verdict({:error, error}, %{ends_flight?: false} = facts, true),
    do: Refusal.deny(:unaudited, command: Intent.label(facts), error: error)

  def verdict(_recorded, _facts, _required?), do: :allow

  defp call(gateway, message, timeout \\ @call_ms) do
    GenServer.call(Names.via(gateway, :audit), message, timeout)
  catch
    :exit, {:timeout, _call} -> {:error, "the audit log did not answer within #{timeout} ms"}
    :exit, _gone -> {:error, "the audit log does not run"}
  end

  # --- Reading the log, of a gateway that runs or one that does not, by its folder

  @doc "The files of the log with their sizes, the oldest first."
  @spec files(Path.t()) :: [{Path.t(), non_neg_integer()}]
  defdelegate files(dir), to: Reader

  @doc "A page of records, the latest first."
  @spec page(Path.t(), Reader.query()) :: {:ok, Reader.page()} | {:error, String.t()}
  defdelegate page(dir, query), to: Reader

  @doc "A value of a record for people."
  @spec format(term()) :: String.t()
  defdelegate format(value), to: Reader

  @doc "Checks that no record was changed or is missing."
  @spec verify(Path.t()) :: {:ok, Verify.report()} | {:error, String.t()}
  defdelegate verify(dir), to: Verify, as: :folder

  @impl GenServer
  def init(options) do
    Process.flag(:trap_exit, true)
    Process.set_label({:audit, options[:gateway]})

    state = %{
      gateway: options[:gateway],
      dir: Path.expand(Keyword.fetch!(options, :dir)),
      max_bytes: Keyword.fetch!(options, :max_bytes),
      log: nil,
      failing: nil,
      since: nil,
      missed: 0,
      tried: nil,
      sync: Keyword.get(options, :sync, &Disk.sync/1),
      sync_due?: false,
      syncing: nil,
      room: nil,
      unwritten: 0
    }

    _ = Process.send_after(self(), :refusals, @refusals_ms)
    state = open(state)
    _ = Task.start(fn -> verify(state.gateway, state.dir) end)
    {:ok, state}
  end

  # The head is checked when the log is opened. All the rest takes time, and nobody waits for it.
  defp verify(gateway, dir) do
    Process.set_label({:audit_verify, gateway})
    Process.flag(:priority, :low)

    with {:ok, %{problems: [_ | _] = problems}} <- Verify.folder(dir),
         # The record being written meanwhile.
         [_ | _] = problems <- Enum.reject(problems, &(&1 =~ "ends within a line")) do
      words = "records of the audit log are not what was written: " <> Enum.join(Enum.take(problems, 3), "; ")
      Damaged.note(gateway, dir, dir, words)
    end
  end

  @impl GenServer
  def handle_call({:append, entry}, _from, state) do
    state = reopen(state)

    case write(state, entry) do
      {:ok, state} -> {:reply, {:ok, elem(Log.head(state.log), 0)}, schedule(state)}
      {:error, reason, state} -> {:reply, {:error, reason}, missed(state)}
    end
  end

  def handle_call(:status, _from, %{log: nil} = state),
    do: {:reply, {:ok, Map.merge(%{n: nil, hash: nil, bytes: nil}, info(state))}, state}

  def handle_call(:status, _from, state) do
    {n, hash} = Log.head(state.log)

    {:reply, {:ok, Map.merge(%{n: n, hash: hash, bytes: Log.bytes(state.log)}, info(state))}, state}
  end

  @impl GenServer
  # Those who may nothing have a part of the log, and what does not fit is counted in the next one.
  def handle_cast({:note, {:refusal, entry}}, state), do: {:noreply, refused(entry, state)}

  def handle_cast({:note, entry}, state) do
    {:reply, _answer, state} = handle_call({:append, entry}, nil, state)
    {:noreply, state}
  end

  # It is reported with the next failure, or by `status/1`.
  def handle_cast(:missed, state), do: {:noreply, missed(state)}

  @impl GenServer
  def handle_info(:refusals, state) do
    _ = Process.send_after(self(), :refusals, @refusals_ms)

    {:noreply,
     state.gateway |> Refusals.due(System.monotonic_time(:microsecond)) |> Enum.reduce(state, &refused/2)}
  end

  # The one before it still waits for the disk; there is one at a time.
  def handle_info(:sync, %{syncing: %Task{}} = state), do: {:noreply, schedule(%{state | sync_due?: false})}

  def handle_info(:sync, %{log: log, sync: sync} = state) do
    task = if log, do: Task.async(fn -> Log.sync(log, sync) end)
    {:noreply, %{state | syncing: task, sync_due?: false}}
  end

  def handle_info({task, result}, %{syncing: %{ref: task}} = state) do
    Process.demonitor(task, [:flush])
    state = %{state | syncing: nil}
    {:noreply, if(result == :ok, do: state, else: failed(state, elem(result, 1)))}
  end

  # A task that has given its answer.
  def handle_info({:EXIT, _pid, :normal}, state), do: {:noreply, state}
  def handle_info({:EXIT, _pid, reason}, state), do: {:stop, reason, state}

  @impl GenServer
  def terminate(_reason, %{log: nil}), do: :ok

  def terminate(_reason, state) do
    _ = if state.syncing, do: Task.shutdown(state.syncing, :brutal_kill)
    Log.close(state.log)
  end

  defp open(state) do
    state = %{state | tried: System.monotonic_time(:millisecond)}

    with :ok <- FolderLock.acquire(state.dir),
         {:ok, log} <- Log.open(state.dir, state.max_bytes, now()) do
      schedule(%{state | log: log})
    else
      {:error, reason} -> failed(state, reason)
    end
  end

  defp refused(entry, state) do
    case Refusals.room(state.room, state.max_bytes, System.monotonic_time(:microsecond)) do
      {:ok, room} ->
        entry = if state.unwritten > 0, do: Map.put(entry, "unwritten", state.unwritten), else: entry
        {:reply, _answer, state} = handle_call({:append, entry}, nil, %{state | room: room, unwritten: 0})
        state

      :none ->
        %{state | unwritten: state.unwritten + Map.get(entry, "count", 1)}
    end
  end

  defp info(state), do: Map.take(state, [:dir, :failing, :missed])

  defp reopen(%{log: nil} = state) do
    if System.monotonic_time(:millisecond) - state.tried >= @retry_ms, do: open(state), else: state
  end

  defp reopen(state), do: state

  defp write(%{log: nil} = state, _entry), do: {:error, state.failing, state}

  defp write(%{failing: nil} = state, entry) do
    case Log.append(state.log, entry, now()) do
      {:ok, log} -> {:ok, %{state | log: log}}
      {:error, reason, log} -> {:error, reason, failed(%{state | log: log}, reason)}
    end
  end

  # The note about missed records comes first, so that the log never looks complete.
  defp write(state, entry) do
    missed = %{
      "type" => "missed",
      "records" => state.missed,
      "since" => state.since |> DateTime.from_unix!(:microsecond) |> DateTime.to_iso8601(),
      "reason" => state.failing
    }

    case Log.append(state.log, missed, now()) do
      {:ok, log} -> write(works(%{state | log: log}), entry)
      {:error, reason, log} -> {:error, reason, %{state | log: log, failing: reason}}
    end
  end

  # Also counted in the read model, if there is one.
  defp missed(state) do
    :ok = Store.count_if_running(state.gateway, {:audit, :missed})
    %{state | missed: state.missed + 1}
  end

  defp failed(%{failing: nil} = state, reason) do
    Logger.error(
      "audit log: #{reason}. Commands that must be recorded are denied until it can be written again"
    )

    :telemetry.execute([:aerie, :audit, :failing], %{count: 1}, %{gateway: state.gateway, reason: reason})
    Names.put_value(state.gateway, :audit, reason)
    %{state | failing: reason, since: now()}
  end

  defp failed(state, reason), do: %{state | failing: reason}

  defp works(state) do
    Logger.warning("audit log: written again; #{state.missed} records are missing")
    :telemetry.execute([:aerie, :audit, :writing], %{missed: state.missed}, %{gateway: state.gateway})
    Names.put_value(state.gateway, :audit, nil)
    %{state | failing: nil, since: nil, missed: 0}
  end

  defp schedule(%{sync_due?: true} = state), do: state

  defp schedule(state) do
    _ = Process.send_after(self(), :sync, @sync_ms)
    %{state | sync_due?: true}
  end

  defp now, do: System.os_time(:microsecond)
end
