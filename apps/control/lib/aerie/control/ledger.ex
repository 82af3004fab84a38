defmodule Aerie.Control.Ledger do
  @moduledoc """
  The ledger of a gateway's commands by their ids, on disk: no id is executed twice, whatever is killed or repeated.

  | | answered with |
  |---|---|
  | a new id | `:new`: execute it |
  | the same command again | `:in_flight`, or `{:stored, result}` |
  | another command with that id | `{:deny, :id, reason}` |
  | a new id, for which there is no room | `{:error, reason}` |
  | after a kill: a command that was not sent | `:new` again, because nothing happened |
  | after a kill: a command that may have been sent | `{:stored, %Result{status: :unknown}}`, and it is never sent again |

  Call `admit/3`, then `sending/4` right before the first byte goes to the vehicle, then `finish/3`. A record is written before
  the answer, so a kill loses none; `sending/4` of a command that must not be repeated (`:never`) also waits for the disk,
  so a power cut loses none either. Nobody else waits for it: a task brings the file to the disk, and all who come meanwhile
  are served by the next one.

  If a record cannot be written, all three return `{:error, reason}`. The record is kept in memory and written as soon as the
  disk has room, so a command that is sent nevertheless, because it brings a vehicle down, is protected until a restart. Until the
  file has been read once, nothing is admitted: only the file knows which ids were used before.

  A file that can no longer be read as a ledger is set aside (`Aerie.Base.Files.Damaged`), as is a copy of one with damaged lines. What ids it had
  is not known, so from then on an unknown command that was issued before is refused: it may have been executed.

  Telemetry: `[:aerie, :ledger, :failing]` (`count` 1; `gateway`, `reason`), once until the ledger can be written again.
  """

  use GenServer

  alias Aerie.Base.Files.{Damaged, Disk, FolderLock}
  alias Aerie.Base.Names
  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.{Refusal, Result}
  alias Aerie.Control.Ledger.{Core, Journal}

  require Logger

  @retry_ms 1_000
  @call_ms 5_000
  # A smaller file is not worth rewriting.
  @compact_bytes 4_194_304

  @lost "what commands it had is not known any more, so those that were issued before now are refused"

  @typedoc """
    * `:dir` - its folder; `:max_entries`, `:max_age_s` - how many commands it keeps, and for how long
    * `:sync` - brings a file to the disk; for tests of a slow one
  """
  @type option ::
          {:gateway, Names.gateway()}
          | {:dir, Path.t()}
          | {:max_entries, pos_integer()}
          | {:max_age_s, pos_integer()}
          | {:sync, (Path.t() -> :ok | {:error, File.posix()})}

  @spec start_link([option()]) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :ledger))

  @doc "Admits a command. This and the steps below wait for `timeout` milliseconds at most."
  @spec admit(Names.gateway(), Command.t(), timeout :: pos_integer()) ::
          :new | :in_flight | {:stored, Result.t()} | Refusal.denial() | {:error, String.t()}
  def admit(gateway, command, timeout \\ @call_ms), do: call(gateway, {:admit, command}, timeout)

  @doc "What `admit/3` would say of a command's id, without admitting it."
  @spec known(Names.gateway(), Command.t(), timeout :: pos_integer()) ::
          :new | :in_flight | {:stored, Result.t()} | Refusal.denial() | {:error, String.t()}
  def known(gateway, command, timeout \\ @call_ms), do: call(gateway, {:known, command}, timeout)

  @doc "The state of an id, or nil."
  @spec lookup(Names.gateway(), String.t()) :: :in_flight | Result.t() | nil | {:error, String.t()}
  def lookup(gateway, id), do: call(gateway, {:lookup, id})

  @doc "Records that the command is about to be sent. Send it as soon as this returns `:ok`."
  @spec sending(Names.gateway(), String.t(), :safe | :never, timeout :: pos_integer()) ::
          :ok | Refusal.denial() | {:error, String.t()}
  def sending(gateway, id, retry, timeout \\ @call_ms), do: call(gateway, {:sending, id, retry}, timeout)

  @doc "Records the result."
  @spec finish(Names.gateway(), Result.t(), timeout :: pos_integer()) ::
          :ok | Refusal.denial() | {:error, String.t()}
  def finish(gateway, result, timeout \\ @call_ms), do: call(gateway, {:finish, result}, timeout)

  @doc """
  The commands that were under way when the gateway stopped, as plain envelopes. Their result is `unknown` until somebody
  has observed the vehicle and calls `finish/3`. `{:error, reason}` until the file has been read.
  """
  @spec interrupted(Names.gateway()) :: [%{String.t() => term()}] | {:error, String.t()}
  def interrupted(gateway), do: call(gateway, :interrupted)

  @doc "The number of commands, the file's bytes, damaged lines that were left out, and why it cannot be written."
  @spec status(Names.gateway()) ::
          %{
            entries: non_neg_integer(),
            bytes: non_neg_integer() | nil,
            damaged: non_neg_integer(),
            failing: String.t() | nil
          }
          | {:error, String.t()}
  def status(gateway), do: call(gateway, :status)

  @doc "Why no command is admitted at this moment, or nil. Waits for nobody."
  @spec problem(Names.gateway()) :: String.t() | nil
  def problem(gateway), do: Names.value(gateway, :ledger)

  defp call(gateway, message, timeout \\ @call_ms) do
    GenServer.call(Names.via(gateway, :ledger), message, timeout)
  catch
    :exit, {:timeout, _call} -> {:error, "the ledger did not answer within #{timeout} ms"}
    :exit, _gone -> {:error, "the ledger does not run"}
  end

  @impl GenServer
  def init(options) do
    Process.flag(:trap_exit, true)
    Process.set_label({:ledger, options[:gateway]})

    state = %{
      gateway: options[:gateway],
      dir: Path.expand(Keyword.fetch!(options, :dir)),
      core: Core.new(Keyword.fetch!(options, :max_entries), Keyword.fetch!(options, :max_age_s)),
      journal: nil,
      interrupted: [],
      damaged: 0,
      failing: nil,
      tried_at: nil,
      compacted: 0,
      sync: Keyword.get(options, :sync, &Disk.sync/1),
      syncing: nil,
      unsynced: []
    }

    {:ok, open(state)}
  end

  @impl GenServer
  def handle_call({:admit, command}, _from, state),
    do: opened(state, &step(Core.admit(&1.core, command, now()), &1))

  def handle_call({what, of}, _from, state) when what in [:known, :lookup],
    do: opened(state, &{:reply, apply(Core, what, [&1.core, of]), &1})

  def handle_call({:sending, id, retry}, from, state) do
    case step(Core.sending(state.core, id, retry, now()), state) do
      {:reply, :ok, state} when retry == :never ->
        {:noreply, sync(%{state | unsynced: [from | state.unsynced]})}

      step ->
        step
    end
  end

  def handle_call({:finish, result}, _from, state) do
    state = %{state | interrupted: Enum.reject(state.interrupted, &(&1["id"] == result.id))}
    step(Core.finish(state.core, result, now()), state)
  end

  def handle_call(:interrupted, _from, state), do: opened(state, &{:reply, &1.interrupted, &1})

  def handle_call(:status, _from, state) do
    bytes = if state.journal, do: state.journal.bytes

    {:reply, %{entries: Core.count(state.core), bytes: bytes, damaged: state.damaged, failing: state.failing},
     state}
  end

  @impl GenServer
  def handle_info({task, result}, %{syncing: {%{ref: task}, callers}} = state) do
    Process.demonitor(task, [:flush])
    for caller <- callers, do: GenServer.reply(caller, result)
    state = if result == :ok, do: state, else: failed(state, elem(result, 1))
    {:noreply, sync(%{state | syncing: nil})}
  end

  # A task that has given its answer.
  def handle_info({:EXIT, _pid, :normal}, state), do: {:noreply, state}
  def handle_info({:EXIT, _pid, reason}, state), do: {:stop, reason, state}

  @impl GenServer
  def terminate(_reason, %{journal: nil}), do: :ok
  def terminate(_reason, state), do: Journal.close(state.journal)

  # A caller that comes while a task runs waits for the next one, because its record may be too late for this sync.
  defp sync(%{syncing: nil, unsynced: [_ | _]} = state) do
    %{journal: %{path: path}, sync: sync} = state
    task = Task.async(fn -> Journal.sync(path, sync) end)
    %{state | syncing: {task, state.unsynced}, unsynced: []}
  end

  defp sync(state), do: state

  defp step({answer, records, core}, state) do
    case store(%{state | core: core}, records) do
      {:ok, state} ->
        {:reply, answer, state}

      {:error, reason, state} ->
        {:reply, if(answer in [:ok, :new], do: {:error, reason}, else: answer), state}
    end
  end

  defp store(state, []), do: {:ok, state}
  defp store(%{journal: nil} = state, _records), do: {:error, state.failing, state}

  defp store(%{failing: nil} = state, records) do
    case Journal.append(state.journal, records) do
      {:ok, journal} -> {:ok, compact(%{state | journal: journal})}
      {:error, reason, journal} -> {:error, reason, failed(%{state | journal: journal}, reason)}
    end
  end

  # The file lacks records, so all are rewritten.
  defp store(state, _records) do
    case rewrite(state) do
      {:ok, state} -> {:ok, works(state)}
      error -> error
    end
  end

  # Rewrite it when it has doubled.
  defp compact(%{journal: %{bytes: bytes}} = state) when bytes < @compact_bytes, do: state
  defp compact(%{journal: %{bytes: bytes}, compacted: last} = state) when bytes < 2 * last, do: state

  defp compact(state) do
    case rewrite(state) do
      {:ok, state} -> state
      # The old file is intact; the next attempt follows when it has grown by as much again.
      {:error, _reason, state} -> %{state | compacted: state.journal.bytes}
    end
  end

  defp rewrite(state) do
    case Journal.compact(state.journal, Core.records(state.core)) do
      {:ok, journal} -> {:ok, %{state | journal: journal, compacted: journal.bytes}}
      {:error, reason, journal} -> {:error, reason, failed(%{state | journal: journal}, reason)}
    end
  end

  defp open(state, set_aside? \\ false) do
    with :ok <- FolderLock.acquire(state.dir),
         {:ok, journal, core, damaged} <- Journal.open(state.dir, state.core, &Core.replay(&2, &1)) do
      if damaged > 0 do
        Damaged.note(
          state.gateway,
          journal.path,
          "#{journal.path}.damaged",
          "#{damaged} lines were damaged; " <> @lost
        )
      end

      {blind, core} = if damaged > 0 or set_aside?, do: Core.blind(core, now()), else: {[], core}
      {interrupted, records, core} = Core.interrupted(core, now())
      records = blind ++ records
      state = %{state | journal: journal, core: core, interrupted: interrupted, damaged: damaged}

      # On the disk before anything of this run is admitted.
      with {:ok, state} <- store(%{state | compacted: journal.bytes}, records),
           :ok <- Journal.sync(journal.path, state.sync) do
        works(state)
      else
        {:error, _reason, state} -> state
        {:error, reason} -> failed(state, reason)
      end
    else
      {:error, :damaged} when not set_aside? -> set_aside(state)
      {:error, reason} -> failed(%{state | tried_at: monotonic()}, reason)
    end
  end

  defp set_aside(state) do
    path = Journal.path(state.dir)

    case Damaged.set_aside(state.gateway, path, @lost) do
      {:ok, _kept} -> open(state, true)
      {:error, reason} -> failed(%{state | tried_at: monotonic()}, "#{path}: #{:file.format_error(reason)}")
    end
  end

  # Until the file was read, nobody knows which commands there are.
  defp opened(state, answer) do
    case reopen(state) do
      %{journal: nil} = state -> {:reply, {:error, state.failing}, state}
      state -> answer.(state)
    end
  end

  defp reopen(%{journal: nil, tried_at: tried} = state),
    do: if(monotonic() - tried >= @retry_ms, do: open(state), else: state)

  defp reopen(state), do: state

  defp failed(%{failing: nil} = state, reason) do
    Logger.error("ledger: #{reason}. Commands are refused until it can be written")
    :telemetry.execute([:aerie, :ledger, :failing], %{count: 1}, %{gateway: state.gateway, reason: reason})
    put_failing(%{state | failing: reason})
  end

  defp failed(state, reason), do: put_failing(%{state | failing: reason})

  defp works(%{failing: nil} = state), do: state

  defp works(state) do
    Logger.warning("ledger: written again")
    put_failing(%{state | failing: nil})
  end

  # For `problem/1`.
  defp put_failing(state) do
    Names.put_value(state.gateway, :ledger, state.failing)
    state
  end

  defp now, do: System.os_time(:microsecond)
  defp monotonic, do: System.monotonic_time(:millisecond)
end
