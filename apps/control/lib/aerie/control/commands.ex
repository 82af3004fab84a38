defmodule Aerie.Control.Commands do
  @moduledoc """
  The only way to command a vehicle. NATS, REST and Elixir command only by it:

      {:ok, result} = Aerie.Control.Commands.submit(gateway, vehicle: "VID-001", type: "takeoff", params: %{altitude:
      20})

  A command passes the ledger (no id is done twice), the rates, the policy, the audit log and the executor of its
  vehicle, in this order, and has exactly one result. `docs/commands.md` describes it for users, the README in
  `commands/` the processes.
  """

  alias Aerie.Base.Names
  alias Aerie.Control.{CommandExecutor, Ledger, Policy, TransferExecutor}
  alias Aerie.Control.CommandExecutor.Offers
  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.{Error, Refusal, Result}

  alias Aerie.Control.Commands.{
    Change,
    Metrics,
    OffboardPrecondition,
    Recent,
    Record,
    Gateways,
    Server
  }

  alias Aerie.Control.Commands.Pipeline.Request

  alias Aerie.Control.Policy.{Audit, Roles}
  alias Aerie.Control.Policy.Intent.Context

  # A caller from Elixir runs inside the gateway.
  @inside Aerie.Control.Policy.Roles.principal(:gateway, "elixir", :admin)

  @typedoc """
    * `:via` - the way that it came, for the audit log; `"elixir"` unless given
    * `:progress` - a process, or one with a term: it gets `{:command_progress, term, id, %{"progress" => share | nil,
      "text" => text | nil}}`, the share being 0..1 and the term nil for a process alone
    * `:wait_ms` - how long to wait for the result, `:infinity` unless given; 0: not at all. The command goes on
  """
  @type option :: {:via, String.t()} | {:progress, pid() | {pid(), term()}} | {:wait_ms, timeout()}

  @typedoc "A command that is under way or done, for those who look on."
  @type entry :: Recent.entry()

  @typedoc "`:pending`: the command with this id is under way; an error: the command is invalid, for these reasons."
  @type answer :: {:ok, Result.t()} | {:pending, String.t()} | {:error, [Error.t(), ...]}

  @doc """
  Carries out a command given by the fields of `Aerie.Vehicle.Command.new/2` and by options, `:as` among them: who
  commands (`t:Aerie.Control.Policy.Roles.source/0`), an admin called `elixir` unless given.
  """
  @spec submit(Names.gateway(), keyword()) :: answer()
  def submit(gateway, fields) do
    {options, fields} = Keyword.split(fields, [:as, :via, :progress, :wait_ms])
    {source, options} = Keyword.pop(options, :as, @inside)
    given = Map.new(fields, fn {name, value} -> {Atom.to_string(name), value} end)
    given |> take(Command.new(fields), gateway, source, options)
  end

  @doc """
  Carries out a command that came from outside, as a map with text keys (`Aerie.Vehicle.Command.parse/2`). `source` is
  who commands, as authentication found out; a `source` in the envelope is a remark that the audit log keeps. Without an
  id it gets one.
  """
  @spec submit(Names.gateway(), map(), Roles.source(), [option()]) :: answer()
  def submit(gateway, envelope, source, options) do
    parsed =
      envelope
      |> Map.put_new_lazy("id", &Command.id/0)
      |> Map.put_new("source", source.name)
      |> Command.parse(System.os_time(:microsecond))

    take(envelope, parsed, gateway, source, options)
  end

  @doc """
  For a gateway that shuts down: no more commands are taken, and those under way are waited for, `commands.grace_s` at
  most, while links and vehicles still run. Callers of those that are left get `unknown`, which the ledger keeps;
  returns their ids.
  """
  @spec drain(Names.gateway()) :: [String.t()]
  def drain(gateway) do
    case Names.value(gateway, :command_server) do
      %{grace_ms: grace_ms} -> Server.drain(gateway, grace_ms)
      nil -> []
    end
  end

  defp take(given, {:error, errors}, gateway, source, options) do
    Record.turned_away(gateway, given, source, via(options), {:deny, :malformed, Enum.join(errors, "; ")})
    {:error, errors}
  end

  defp take(given, {:ok, command}, gateway, source, options) do
    says = if given["source"], do: command.source
    pass(gateway, of(command, source, says, options), source, says, options)
  end

  @doc """
  Carries out something that is not a command of the table (`Aerie.Control.Commands.Change`) with the authority of a
  source, as a command of the type that its facts name: what it changes is in `params`, short enough for the audit log.
  The caller has checked its id and deadline.
  """
  @spec carry_out(Names.gateway(), Command.t(), Change.t(), Roles.source(), [option()]) :: answer()
  def carry_out(gateway, command, %Change{} = change, source, options) do
    {says, options} = Keyword.pop(options, :says)
    pass(gateway, of(command, source, says, options), source, says, [change: change] ++ options)
  end

  # A gateway that passes a command on signs it and says for whom; then it is the same command as by any other way.
  defp of(command, source, says, options) do
    relayed? = via(options) == "nats" and match?(%{kind: :key}, source)
    %{command | source: source.name, sender: if(relayed?, do: Command.sender(says))}
  end

  defp pass(gateway, command, source, says, options) do
    wait_ms = Keyword.get(options, :wait_ms, :infinity)

    request = %Request{
      command: command,
      source: source,
      via: via(options),
      says: says,
      progress: progress(options[:progress]),
      change: options[:change],
      wait?: wait_ms != 0
    }

    Server.submit(gateway, request, if(wait_ms == 0, do: 5_000, else: wait_ms))
  end

  @doc "The source of calls from Elixir without `:as`: an admin, because such code runs inside the gateway anyway."
  @spec inside() :: Roles.source()
  def inside, do: @inside

  defp via(options), do: Keyword.get(options, :via, "elixir")

  defp progress(pid) when is_pid(pid), do: {pid, nil}
  defp progress(other), do: other

  @doc """
  What would become of a command if it were given now, without giving it; for forms and buttons. Fields as for
  `submit/2`, `:as` among them.

    * `:allow`
    * `{:deny, rule, reason}` - a rule of the policy, or `:policy` (there is none), `:vehicle` (there is no such
      vehicle), `:firmware` (this firmware lacks the command, or cannot do it in the present state)
    * `{:error, errors}` - the fields are not a valid command

  It changes nothing: no rate is used up and nothing is recorded. Rates, ledger and audit log may still refuse the
  command.
  """
  @spec check(Names.gateway(), keyword()) ::
          :allow | {:deny, rule :: atom(), reason :: String.t()} | {:error, [Error.t(), ...]}
  def check(gateway, fields) do
    {source, fields} = Keyword.pop(fields, :as, @inside)

    with {:ok, command} <- Command.new(fields),
         {:policy, %Policy{} = policy} <- {:policy, Policy.in_force(gateway)},
         %{} = snapshot <- Gateways.vehicle(gateway, command.vehicle),
         context = Context.of(gateway, snapshot, source, System.os_time(:microsecond)),
         :allow <- Policy.decide(policy, command, context),
         {:ok, _steps} <- Offers.plan(command, snapshot),
         :ok <- setpoints(gateway, command, snapshot) do
      :allow
    else
      nil -> Refusal.deny(:no_vehicle, id: fields[:vehicle])
      {:policy, nil} -> Refusal.deny(:no_policy)
      {:gap, reason} -> {:deny, :firmware, reason}
      {:error, reason} when is_binary(reason) -> {:deny, :firmware, reason}
      {:deny, :setpoints, reason} -> {:deny, :firmware, reason}
      denied_or_malformed -> denied_or_malformed
    end
  end

  defp setpoints(_gateway, _command, %{via: via}) when via != nil, do: :ok
  defp setpoints(gateway, command, snapshot), do: OffboardPrecondition.check(gateway, command, snapshot)

  @doc """
  Cancels a command under way; its submitter gets the result. The source must be allowed to give that command.
  """
  @spec cancel(Names.gateway(), vehicle :: String.t(), id :: String.t(), Roles.source(), via :: String.t()) ::
          :ok | {:error, :unknown | :role | :impossible, String.t()}
  def cancel(gateway, vehicle, id, source, via \\ "elixir") do
    with {:ok, job} <- of_vehicle(Server.under_way(gateway, id), vehicle, id),
         :ok <- may_cancel(job, source) do
      Audit.note(gateway, %{
        "type" => "cancel",
        "id" => id,
        "vehicle" => vehicle,
        "command" => job.type,
        "source" => source.name,
        "via" => via
      })

      with %{} = snapshot <- Gateways.vehicle(gateway, vehicle),
           :ok <- cancel_job(gateway, Gateways.reached(gateway, snapshot), job, id) do
        :ok
      else
        nil -> {:error, :impossible, "the vehicle is not known"}
        {:error, reason} -> {:error, :impossible, reason}
      end
    end
  end

  defp cancel_job(gateway, %{via: via} = snapshot, _job, id) when via != nil,
    do: Gateways.module(gateway).cancel(gateway, snapshot, id)

  defp cancel_job(gateway, %{key: key}, %{change?: true}, id), do: TransferExecutor.cancel(gateway, key, id)
  defp cancel_job(gateway, %{key: key}, _command, id), do: CommandExecutor.cancel(gateway, key, id)

  defp of_vehicle(%{vehicle: vehicle} = job, vehicle, _id), do: {:ok, job}
  defp of_vehicle(_other, vehicle, id), do: {:error, :unknown, "no command #{id} of #{vehicle} is under way"}

  defp may_cancel(%{permission: permission} = job, source) do
    if Roles.allowed?(source, permission),
      do: :ok,
      else:
        {:error, :role,
         Refusal.text(:cancel_needs, command: job.type, permission: permission, source: source.name)}
  end

  @doc "The state of a command: under way with its last progress, its result, or unknown."
  @spec state(Names.gateway(), vehicle :: String.t(), id :: String.t()) ::
          {:under_way, Server.under_way()} | {:ok, Result.t()} | nil | {:error, String.t()}
  def state(gateway, vehicle, id) do
    with nil <- Server.under_way(gateway, id) do
      case Ledger.lookup(gateway, id) do
        %Result{details: %{"vehicle" => other}} when other != vehicle -> nil
        %Result{} = result -> {:ok, result}
        {:error, reason} -> {:error, reason}
        # Just before or after its task.
        _nothing -> nil
      end
    else
      %{vehicle: ^vehicle} = job -> {:under_way, job}
      _of_another -> nil
    end
  end

  @doc """
  The commands of a vehicle for those who look on, the latest first: those under way, then at most `limit` done ones.
  """
  @spec recent(Names.gateway(), vehicle :: String.t(), limit :: non_neg_integer()) :: [entry()]
  defdelegate recent(gateway, vehicle, limit \\ 20), to: Recent, as: :of

  @doc """
  Why somebody cannot give a command to the vehicle of a snapshot, by its firmware or for want of a permission. nil: it
  may be offered, and `check/2` says what would become of it now.
  """
  @spec lacks(vehicle :: map(), type :: String.t(), Roles.source(), params :: map()) :: Offers.lack() | nil
  defdelegate lacks(vehicle, type, source, params \\ %{}), to: Offers

  @doc "Records a command that was refused before it was known who sent it: `envelope` is as it came."
  @spec turned_away(Names.gateway(), map(), Roles.source() | nil, String.t(), Refusal.denial()) :: :ok
  defdelegate turned_away(gateway, envelope, who, via, denial), to: Record

  @doc "Whether the metrics of commands show a counter of the read model."
  @spec counter?(term()) :: boolean()
  defdelegate counter?(name), to: Metrics, as: :own?

  @doc "The metrics of commands."
  @spec metrics(Names.gateway()) :: [Metrics.metric()]
  defdelegate metrics(gateway), to: Metrics, as: :all
end
