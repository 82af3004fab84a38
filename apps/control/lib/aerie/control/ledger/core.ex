defmodule Aerie.Control.Ledger.Core do
  @moduledoc """
  What is known about each command by its id, as a pure value: the digest of its content, whether it was sent, its result.

  Each step returns an answer, the records that have to be on disk before the answer is given, and the new state. `replay/2` makes the
  state from records.

  An entry is kept for at least `keep_us`: within that time a repetition of its envelope would still be accepted as
  fresh. So while the ledger is full of younger entries, no new command is admitted. Only denied commands,
  which were never sent, are dropped earlier, so that a source that may not command cannot block the others.
  """

  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.{Refusal, Result}

  # Envelopes may be 10 minutes old, with 5 more until their deadline; the rest is a margin for clocks.
  @keep_us 20 * 60 * 1_000_000

  defstruct [:max_entries, :max_age_us, :by_age, :denied, :blind, entries: %{}]

  @typedoc """
  `blind`: when records were found to be lost, nil if never. `:received` is not sent yet; `:sent` may be under way; a `t:Result.t/0` is the end. `command` is the envelope as
  plain values, nil once there is a result other than the `unknown` of a restart.
  """
  @type entry :: %{
          digest: String.t(),
          at: integer(),
          state: :received | :sent | Result.t(),
          command: %{String.t() => term()} | nil
        }
  @type t :: %__MODULE__{
          max_entries: pos_integer(),
          max_age_us: pos_integer(),
          blind: integer() | nil,
          entries: %{String.t() => entry()},
          by_age: :gb_sets.set({integer(), String.t()}),
          denied: :gb_sets.set({integer(), String.t()})
        }

  @typedoc "A record as plain values, for a line of JSON."
  @type line :: [term(), ...]

  @doc "An empty ledger. It drops entries older than `max_age_s`, and the oldest beyond `max_entries`."
  @spec new(pos_integer(), pos_integer()) :: t()
  def new(max_entries, max_age_s),
    do: %__MODULE__{
      max_entries: max_entries,
      max_age_us: max(max_age_s * 1_000_000, @keep_us),
      by_age: :gb_sets.new(),
      denied: :gb_sets.new()
    }

  @doc """
  Admits a command: `:new`, or what is known about its id. `:in_flight`: the same command is under way; `{:stored, result}`:
  it has ended; `{:deny, :id, reason}`: another command has the id; `{:error, reason}`: the ledger is full.
  """
  @spec admit(t(), Command.t(), now :: integer()) ::
          {:new | :in_flight | {:stored, Result.t()} | Refusal.denial() | {:error, String.t()}, [line()], t()}
  def admit(core, command, now) do
    core = forget(core, now)
    digest = Command.digest(command)

    case known(core, command, digest) do
      :new -> room(core, command, digest, now)
      answer -> {answer, [], core}
    end
  end

  @doc "What `admit/3` would say of a command's id, without admitting it."
  @spec known(t(), Command.t()) :: :new | :in_flight | {:stored, Result.t()} | Refusal.denial()
  def known(core, command), do: known(core, command, Command.digest(command))

  defp known(core, %{id: id} = command, digest) do
    case core.entries do
      %{^id => %{digest: ^digest, state: %Result{} = result}} ->
        {:stored, result}

      %{^id => %{digest: ^digest}} ->
        :in_flight

      %{^id => _other} ->
        Refusal.deny(:id_used, id: id)

      _unknown when core.blind != nil and command.issued_at <= core.blind ->
        Refusal.deny(:ledger_blind, id: id)

      _unknown ->
        :new
    end
  end

  @doc "Records were lost: unknown commands that were issued until `now` are refused."
  @spec blind(t(), now :: integer()) :: {[line()], t()}
  def blind(core, now), do: {[["blind", now]], %{core | blind: now}}

  @doc "The state of an id, or nil."
  @spec lookup(t(), String.t()) :: :in_flight | Result.t() | nil
  def lookup(core, id) do
    case core.entries do
      %{^id => %{state: %Result{} = result}} -> result
      %{^id => _under_way} -> :in_flight
      _unknown -> nil
    end
  end

  @doc """
  Records that a command is about to be sent. One that must not be repeated (`:never`) gets `:ok` only once; its record has to be
  safe on disk before it is sent.
  """
  @spec sending(t(), String.t(), :safe | :never, now :: integer()) ::
          {:ok | Refusal.denial(), [line()], t()}
  def sending(core, id, retry, now) do
    case core.entries do
      %{^id => %{state: :received} = entry} ->
        {:ok, [["sent", id, now]], put(core, id, %{entry | state: :sent})}

      %{^id => %{state: :sent}} when retry == :safe ->
        {:ok, [], core}

      %{^id => %{state: :sent}} ->
        {Refusal.deny(:sent_already, id: id), [], core}

      %{^id => _done} ->
        {Refusal.deny(:ended_already, id: id), [], core}

      _unknown ->
        {Refusal.deny(:not_in_ledger, id: id), [], core}
    end
  end

  @doc "Records a result. A result is final, except `unknown`, which a later observation of the vehicle may replace."
  @spec finish(t(), Result.t(), now :: integer()) :: {:ok | Refusal.denial(), [line()], t()}
  def finish(core, %Result{id: id} = result, now) do
    case core.entries do
      %{^id => %{state: %Result{status: status}}} when status != :unknown ->
        {Refusal.deny(:ended_already, id: id), [], core}

      %{^id => entry} ->
        {:ok, [done(result, now)], ended(core, id, entry, result)}

      _unknown ->
        {Refusal.deny(:not_in_ledger, id: id), [], core}
    end
  end

  @doc """
  Cleans up after a restart. A command that was not sent is forgotten: nothing happened, and it may come again. One that may have been sent is
  `unknown` from now on and never sent again; these commands are returned, so that somebody can observe what became of them.
  """
  @spec interrupted(t(), now :: integer()) :: {[%{String.t() => term()}], [line()], t()}
  def interrupted(core, now) do
    core = forget(core, now)

    Enum.reduce(core.entries, {[], [], core}, fn
      {id, %{state: :received}}, {commands, records, core} ->
        {commands, [["gone", id] | records], drop(core, id)}

      {id, %{state: :sent, command: command} = entry}, {commands, records, core} ->
        {[command | commands], [["interrupted", id, now] | records], interrupt(core, id, entry)}

      # From an earlier start, and not observed yet.
      {_id, %{state: %Result{}, command: %{} = command}}, {commands, records, core} ->
        {[command | commands], records, core}

      {_id, _done}, acc ->
        acc
    end)
  end

  @doc "Applies a record of the file. An invalid one changes nothing."
  @spec replay(t(), line()) :: t()
  def replay(core, ["new", id, digest, at, command])
      when is_binary(id) and is_binary(digest) and is_integer(at) and (is_map(command) or command == nil) do
    put(core, id, %{digest: digest, at: at, state: :received, command: command})
  end

  def replay(core, ["sent", id, _at]) do
    case core.entries do
      %{^id => %{state: :received} = entry} -> put(core, id, %{entry | state: :sent})
      _other -> core
    end
  end

  def replay(core, ["interrupted", id, _at]) do
    case core.entries do
      %{^id => entry} -> interrupt(core, id, entry)
      _other -> core
    end
  end

  def replay(core, ["done", id, _at, status, reason, details]) when is_map(details) do
    with %{^id => entry} <- core.entries,
         {:ok, status} <- Result.status(status) do
      ended(core, id, entry, Result.new(id, status, reason, details))
    else
      _other -> core
    end
  end

  def replay(core, ["gone", id]), do: drop(core, id)
  def replay(core, ["blind", at]) when is_integer(at), do: %{core | blind: max(at, core.blind || at)}
  def replay(core, _other), do: core

  @doc "The records of this state, for a new file."
  @spec records(t()) :: Enumerable.t(line())
  def records(core) do
    blind = if core.blind, do: [["blind", core.blind]], else: []

    core.entries
    |> Stream.flat_map(fn {id, entry} ->
      new = ["new", id, entry.digest, entry.at, entry.command]

      case entry.state do
        :received -> [new]
        :sent -> [new, ["sent", id, entry.at]]
        %Result{} when entry.command != nil -> [new, ["interrupted", id, entry.at]]
        %Result{status: :denied} = result -> [new] ++ sent(core, id, entry) ++ [done(result, entry.at)]
        result -> [new, done(result, entry.at)]
      end
    end)
    |> then(&Stream.concat(blind, &1))
  end

  @doc "The number of commands in the ledger."
  @spec count(t()) :: non_neg_integer()
  def count(core), do: map_size(core.entries)

  # The command is kept, so that its outcome can be observed.
  defp interrupt(core, id, entry) do
    put(core, id, %{entry | state: Refusal.result(id, Refusal.ended(:gateway_stopped))})
  end

  defp sent(core, id, entry) do
    if :gb_sets.is_element({entry.at, id}, core.denied), do: [], else: [["sent", id, entry.at]]
  end

  defp done(result, now),
    do: ["done", result.id, now, Atom.to_string(result.status), result.reason, result.details]

  defp room(core, command, digest, now) do
    {core, gone} = if count(core) >= core.max_entries, do: evict(core, now), else: {core, []}

    if count(core) < core.max_entries do
      plain = Command.plain(command)
      entry = %{digest: digest, at: now, state: :received, command: plain}
      {:new, gone ++ [["new", command.id, digest, now, plain]], put(core, command.id, entry)}
    else
      {{:error,
        "the ledger holds #{core.max_entries} commands of the last 20 minutes; there is no room for another one"},
       gone, core}
    end
  end

  # The oldest entry if it is old enough, otherwise the oldest denied one.
  defp evict(core, now) do
    {at, id} = :gb_sets.smallest(core.by_age)

    cond do
      now - at > @keep_us -> {drop(core, id), [["gone", id]]}
      :gb_sets.is_empty(core.denied) -> {core, []}
      true -> core.denied |> :gb_sets.smallest() |> elem(1) |> then(&{drop(core, &1), [["gone", &1]]})
    end
  end

  # This needs no records: reading the old ones drops the same entries.
  defp forget(core, now) do
    with false <- :gb_sets.is_empty(core.by_age),
         {at, id} when now - at > core.max_age_us <- :gb_sets.smallest(core.by_age) do
      core |> drop(id) |> forget(now)
    else
      _young -> core
    end
  end

  defp put(core, id, entry) do
    core = drop(core, id)
    %{core | entries: Map.put(core.entries, id, entry), by_age: :gb_sets.add({entry.at, id}, core.by_age)}
  end

  # Stores the result; `entry` is the previous state.
  defp ended(core, id, entry, result) do
    core = put(core, id, %{entry | state: result, command: nil})

    if entry.state == :received and result.status == :denied,
      do: %{core | denied: :gb_sets.add({entry.at, id}, core.denied)},
      else: core
  end

  defp drop(core, id) do
    case core.entries do
      %{^id => %{at: at}} ->
        %{
          core
          | entries: Map.delete(core.entries, id),
            by_age: :gb_sets.delete({at, id}, core.by_age),
            denied: :gb_sets.delete_any({at, id}, core.denied)
        }

      _unknown ->
        core
    end
  end
end
