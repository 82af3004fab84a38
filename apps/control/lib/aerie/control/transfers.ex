defmodule Aerie.Control.Transfers do
  @moduledoc """
  What `Aerie.Control.Params`, `Aerie.Control.Missions`, `Aerie.Control.Files` and `Aerie.Control.Logs` have in
  common: who starts a transfer, for which vehicle, with which time limit, and what its end means.

  Reading needs no permission and is not recorded. A change passes the same checks as a command
  (`Aerie.Control.Commands.carry_out/5`): the policy's roles and rules, the audit log, and the ledger by its id.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.{Commands, TransferExecutor}
  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.{Error, Result}
  alias Aerie.Control.Commands.{Change, Gateways}
  alias Aerie.Control.Policy.{Intent, Roles}
  alias Aerie.Control.Policy.Mavlink.SystemId
  alias Aerie.Control.Transfers.{Outcome, Progress}
  alias Aerie.Control.TransferExecutor.Job

  @typedoc """
    * `:as` - who asks (`t:Aerie.Control.Policy.Roles.source/0`), by default an admin called `elixir`; `:via` - the
      interface, for the audit log
    * `:id` - the id of a change: the same id with the same content is carried out once. 1 to 64 letters, digits, `-`
      and `_`
    * `:progress` - a process, or one with a term: it gets `{:command_progress, term, id, progress}` as for commands;
      the progress has `"phase"` (`"waiting"`, `"sending"`, `"reading"` or `"checking"`), `"done"` and `"total"` besides
    * `:timeout_ms` - the time limit, including the wait for other transfers; without it a transfer has the time that
      its length needs, and ends when the vehicle does not answer any more
    * `:yields` - whether a read ends as soon as another transfer, or a ground station's, wants its place; by default
      that of a viewer does
    * `:wait_ms` - how long to wait for the result of a change, which then continues by itself; by default `:infinity`
  """
  @type option ::
          {:as, Roles.source()}
          | {:via, String.t()}
          | {:id, String.t()}
          | {:progress, pid() | {pid(), term()}}
          | {:timeout_ms, pos_integer()}
          | {:yields, boolean()}
          | {:wait_ms, timeout()}

  @options [:as, :via, :says, :id, :progress, :timeout_ms, :wait_ms]

  @typedoc """
  A transfer: the lanes that it uses, the function that makes its machine (`t:Aerie.Control.TransferExecutor.Job.t/0`),
  its default time limit (`time_ms/2`), and for reads a term: identical reads, which have the same term, share one
  transfer. `context.grows?`: nobody gave a time limit, so it may grow with the length that the vehicle reports.
  """
  @type transfer :: %{
          required(:lanes) => [Job.lane(), ...],
          required(:start) => (Job.context(), until :: integer() -> {:ok, struct()} | {:error, term()}),
          required(:timeout_ms) => pos_integer(),
          optional(:share) => term()
        }

  @typedoc """
  What a transfer changes: its type for the policy, what the audit log records, `review` of
  `t:Aerie.Control.Commands.Change.t/0`, and, when the change was allowed, `gap`: why the vehicle's firmware lacks
  what is changed, and `before`: what is found out before it begins, as a function that adds it to the result.
  """
  @type change :: %{
          required(:facts) => Intent.t(),
          required(:params) => %{atom() => term()},
          optional(:gap) => (snapshot :: map() -> String.t() | nil),
          optional(:before) => (snapshot :: map() -> (Result.t() -> Result.t())),
          optional(:review) => term(),
          optional(:sets) => [{String.t(), term()}],
          optional(:remote_request) => Gateways.request()
        }

  @doc "The longest time limit that NATS and REST accept, in seconds."
  @spec max_timeout_s() :: pos_integer()
  def max_timeout_s, do: 3_600

  @doc """
  The time limit of a transfer of so many pieces, each of which may take `each_ms`: that of a slow radio. Transfers end
  sooner when the vehicle falls silent, so the limit is for one that answers and does not come to an end.
  """
  @spec time_ms(pieces :: non_neg_integer(), each_ms :: pos_integer()) :: pos_integer()
  def time_ms(pieces, each_ms) when is_integer(pieces) and is_integer(each_ms),
    do: max(300_000, 60_000 + pieces * each_ms)

  @doc """
  The present snapshot of a vehicle by its name, if this gateway's links hear it: what asks for this is not
  passed on.
  """
  @spec vehicle(Names.gateway(), String.t()) :: {:ok, map()} | {:error, Result.t()}
  def vehicle(gateway, id) do
    case Gateways.vehicle(gateway, id) do
      nil ->
        {:error, Result.new(Command.id(), :rejected, "there is no vehicle #{id}", %{"rule" => "vehicle"})}

      %{via: via} when via != nil ->
        {:error, Result.new(Command.id(), :rejected, Gateways.only(via), %{"rule" => "elsewhere"})}

      snapshot ->
        {:ok, snapshot}
    end
  end

  @doc """
  Asks the gateway that hears a vehicle to read something, and gives its answer; `:here` for one that is not to be
  asked for elsewhere: this gateway hears it, nobody does, or the question came from another gateway.
  """
  @spec read_remote(
          Names.gateway(),
          String.t(),
          Gateways.request(),
          [option()]
        ) ::
          :here | {:ok, %{String.t() => term()}} | {:error, Result.t()}
  def read_remote(gateway, vehicle, request, options) do
    with true <- options[:via] != "nats",
         %{via: via} = snapshot when via != nil <- Gateways.vehicle(gateway, vehicle),
         module when module != nil <- Gateways.module(gateway) do
      id = options[:id] || Command.id()
      who = Command.passed_on(source(options).name, options[:via] || "elixir")
      tell = teller(options[:progress], id)
      module.transfer(gateway, snapshot, id, request, who, options[:timeout_ms], tell)
    else
      _here -> :here
    end
  end

  @doc """
  Reads something: returns the machine's value, or a result that says why there is none. `fun` folds the bytes that
  the machine delivers (`{:data, offset, bytes}`), starting with `acc`.
  """
  @spec read(Names.gateway(), map(), transfer(), [option()], acc, (TransferExecutor.event(), acc -> acc)) ::
          {{:ok, term()} | {:error, Result.t()}, acc}
        when acc: term()
  def read(gateway, snapshot, transfer, options, acc \\ nil, fun \\ fn _event, acc -> acc end) do
    id = options[:id] || Command.id()
    tell = teller(options[:progress], id)
    {result, acc} = run(gateway, snapshot, id, transfer, options, tell, acc, fun)

    case Outcome.of(result) do
      {:ok, value} -> {{:ok, value}, acc}
      {status, reason, details} -> {{:error, Result.new(id, status, reason, details)}, acc}
    end
  end

  @doc """
  Changes something: returns the answer of `Aerie.Control.Commands`. `finish` makes the details of a success. Raises
  `ArgumentError` for an option that is not one: with a misspelt `:as` anybody would be an admin.
  """
  @spec change(Names.gateway(), String.t(), change(), transfer(), [option()], (term() -> map())) ::
          Commands.answer()
  def change(gateway, vehicle, change, transfer, options, finish \\ fn _value -> %{} end) do
    options = Keyword.validate!(options, @options)
    timeout_ms = options[:timeout_ms] || transfer.timeout_ms
    now = System.os_time(:microsecond)

    command = %Command{
      id: options[:id] || Command.id(),
      vehicle: vehicle,
      type: change.facts.type,
      params: change.params,
      source: "",
      issued_at: now,
      deadline: now + timeout_ms * 1000
    }

    work = %Change{
      facts: change.facts,
      review: change[:review],
      timeout_ms: options[:timeout_ms],
      remote_request: change[:remote_request],
      run: fn snapshot, tell ->
        with nil <- change[:gap] && change.gap.(snapshot) do
          renamed = renaming(gateway, snapshot, change[:sets] || [], command.id)
          complete = Map.get(change, :before, fn _snapshot -> & &1 end).(snapshot)

          {result, nil} =
            run(gateway, snapshot, command.id, transfer, options, tell, nil, fn _, acc -> acc end)

          case Outcome.of(result) do
            {:ok, value} -> Result.new(command.id, :completed, nil, finish.(value))
            {status, reason, details} -> Result.new(command.id, status, reason, details)
          end
          |> renamed.()
          |> complete.()
        else
          lacking -> Result.new(command.id, :rejected, lacking)
        end
      end
    }

    with :ok <- named(command.id),
         do:
           Commands.carry_out(
             gateway,
             command,
             work,
             source(options),
             Keyword.take(options, [:via, :progress, :wait_ms, :says])
           )
  end

  # A vehicle that has the new system id answers nothing that the old one was asked.
  defp renaming(gateway, snapshot, sets, id) do
    {asker, ref} = {self(), make_ref()}

    SystemId.follow(gateway, snapshot, sets, fn name ->
      send(asker, {ref, name})
      TransferExecutor.cancel(gateway, snapshot.key, id)
    end)

    fn result ->
      receive do
        {^ref, name} ->
          unanswered? = result.status in [:cancelled, :timeout, :unknown]
          result = if unanswered?, do: %{result | status: :completed, reason: nil}, else: result
          result = put_in(result.details["vehicle_now"], name)
          Result.remark(result, ["the vehicle has the new system id, and is #{name} now"])
      after
        0 -> result
      end
    end
  end

  @doc "The source given by the options."
  @spec source([option()]) :: Roles.source()
  def source(options), do: Keyword.get_lazy(options, :as, &Commands.inside/0)

  @doc "Cancels a read; use `Aerie.Control.Commands.cancel/5` for a change."
  @spec cancel(Names.gateway(), String.t(), id :: String.t()) :: :ok | {:error, String.t()}
  def cancel(gateway, vehicle, id) do
    case Store.vehicle(gateway, vehicle) do
      nil -> {:error, "there is no vehicle #{vehicle}"}
      %{key: key} -> TransferExecutor.cancel(gateway, key, id)
    end
  end

  defp named(id) do
    if is_binary(id) and Command.token?(id),
      do: :ok,
      else: {:error, [Error.new("id", "1 to 64 letters, digits, - and _", id)]}
  end

  defp run(gateway, snapshot, id, transfer, options, tell, acc, fun) do
    until = System.monotonic_time(:microsecond) + (options[:timeout_ms] || transfer.timeout_ms) * 1000

    job = %Job{
      id: id,
      lanes: transfer.lanes,
      start: &transfer.start.(Map.put(&1, :grows?, options[:timeout_ms] == nil), until),
      until: until,
      share: transfer[:share],
      yields: Keyword.get_lazy(options, :yields, fn -> transfer[:share] != nil and viewer?(options) end)
    }

    TransferExecutor.run(gateway, snapshot.key, job, acc, fn
      {:progress, progress}, acc ->
        tell.(Progress.plain(progress))
        acc

      event, acc ->
        fun.(event, acc)
    end)
  end

  defp viewer?(options), do: match?(%{role: :viewer}, source(options))

  defp teller(nil, _id), do: fn _progress -> :ok end
  defp teller(pid, id) when is_pid(pid), do: teller({pid, nil}, id)

  defp teller({pid, tag}, id) do
    fn progress ->
      send(pid, {:command_progress, tag, id, progress})
      :ok
    end
  end
end
