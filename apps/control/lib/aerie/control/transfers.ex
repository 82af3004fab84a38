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
  alias Aerie.Vehicle.Command.{Error, Refusal, Result}
  alias Aerie.Control.Commands.{Change, Gateways}
  alias Aerie.Control.Policy.Roles
  alias Aerie.Control.TransferExecutor.Outcome

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

  @typedoc "What becomes of a change."
  @type answer :: Commands.answer()

  @options [:as, :via, :says, :id, :progress, :timeout_ms, :wait_ms]

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
      nil -> error(Refusal.deny(:no_vehicle, id: id))
      %{via: via} when via != nil -> error(Refusal.deny(:elsewhere, via: via))
      snapshot -> {:ok, snapshot}
    end
  end

  @doc "The result of what was refused or has ended before there was a transfer."
  @spec error(Refusal.denial() | {Result.status(), String.t()}, [option()]) :: {:error, Result.t()}
  def error(ended, options \\ []), do: {:error, Refusal.result(options[:id] || Command.id(), ended)}

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
  @spec read(Names.gateway(), map(), TransferExecutor.transfer(), [option()], acc, (TransferExecutor.event(),
                                                                                    acc ->
                                                                                      acc)) ::
          {{:ok, term()} | {:error, Result.t()}, acc}
        when acc: term()
  def read(gateway, snapshot, transfer, options, acc \\ nil, fun \\ fn _event, acc -> acc end) do
    id = options[:id] || Command.id()
    tell = teller(options[:progress], id)
    options = Keyword.put_new_lazy(options, :yields, fn -> transfer[:share] != nil and viewer?(options) end)
    {result, acc} = TransferExecutor.run(gateway, snapshot.key, id, transfer, options, tell, acc, fun)

    case Outcome.of(result, id) do
      {:ok, value} -> {{:ok, value}, acc}
      {:ended, result} -> {{:error, result}, acc}
    end
  end

  @doc """
  Changes something: returns the answer of `Aerie.Control.Commands`. Raises `ArgumentError` for an option that is not
  one: with a misspelt `:as` anybody would be an admin.
  """
  @spec change(Names.gateway(), String.t(), Change.t(), [option()]) :: answer()
  def change(gateway, vehicle, change, options) do
    options = Keyword.validate!(options, @options)
    change = %{change | timeout_ms: options[:timeout_ms]}
    now = System.os_time(:microsecond)

    command = %Command{
      id: options[:id] || Command.id(),
      vehicle: vehicle,
      type: change.facts.type,
      params: change.params,
      source: "",
      issued_at: now,
      deadline: now + (change.timeout_ms || change.limit_ms) * 1000
    }

    given = Keyword.take(options, [:via, :progress, :wait_ms, :says])
    with :ok <- named(command.id), do: Commands.carry_out(gateway, command, change, source(options), given)
  end

  @doc "The source given by the options."
  @spec source([option()]) :: Roles.source()
  def source(options), do: Keyword.get_lazy(options, :as, &Commands.inside/0)

  @doc "Cancels a read; use `Aerie.Control.Commands.cancel/5` for a change."
  @spec cancel(Names.gateway(), String.t(), id :: String.t()) :: :ok | {:error, String.t()}
  def cancel(gateway, vehicle, id) do
    case Store.vehicle(gateway, vehicle) do
      nil -> {:error, Refusal.text(:no_vehicle, id: vehicle)}
      %{key: key} -> TransferExecutor.cancel(gateway, key, id)
    end
  end

  defp named(id) do
    if is_binary(id) and Command.token?(id),
      do: :ok,
      else: {:error, [Error.new("id", "1 to 64 letters, digits, - and _", id)]}
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
