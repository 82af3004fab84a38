defmodule Aerie.Fleet.Replay.PolicyTrial do
  @moduledoc """
  What a policy would have decided about the commands of recorded flights: `Aerie.Fleet.Replay.Commands` finds them,
  `Aerie.Control.Policy.Clients.Trial` decides. A pure value: the same recordings and the same ledger always give the same decisions.

  A recording tells the MAVLink ids of a sender only, so `:as` says whose commands they are. Commands of the ledger have their sender's
  name; from its first command on they stand for what the gateway's own ids send. Transfers (parameters, missions, files) are judged by their
  frames, since the ledger does not have what they carry, and their sender is the one of the last transfer in the ledger.
  """

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{Intent, Roles}
  alias Aerie.Control.Policy.Clients.Trial
  alias Aerie.Fleet.Replay.{Commands, Machine, Settings}
  alias Aerie.Vehicle.Command
  alias MavCodec.Frame

  @enforce_keys [:settings, :as, :named, :trial, :commands]
  defstruct @enforce_keys ++
              [
                :label,
                :network,
                :first,
                :last,
                ledger: [],
                pending: nil,
                passed: %{},
                judged: MapSet.new(),
                transfers: %{},
                unnamed: MapSet.new(),
                counts: %{}
              ]

  # A recording is followed by the next one of its flight within this time.
  @next_us 60_000_000
  @back_us 2_000_000

  @gateway "gateway"
  @transfer_classes [:parameter, :mission, :file]

  @typedoc "A ground station or program by its MAVLink ids (`255/190`), or the sender of a command that the gateway carried out, by its name."
  @type sender :: {:station | :source, String.t()}

  @typedoc """
  - `:as` - the principal of a sender of whom no more is known (`t:sender/0`)
  - `:named` - the principal of a name of the ledger at a time, nil for one that is not known
  - `:ledger` - commands as `Aerie.Control.Ledger.Envelopes.read/1` gives them
  """
  @type option ::
          {:as, (sender() -> Roles.source())}
          | {:named, (String.t(), integer() -> Roles.source() | nil)}
          | {:ledger, [Aerie.Control.Ledger.Envelopes.entry()]}

  @typedoc "`:who` - as far as it is known; `:name` - the command or message as it came; `:command` - its type for the policy."
  @type decision :: %{
          at: integer(),
          vehicle: String.t(),
          who: String.t(),
          role: Roles.role(),
          via: String.t(),
          name: String.t(),
          command: String.t(),
          decision: Policy.decision() | {:deny, :rate, String.t()},
          lacking: [atom()]
        }
  @type t :: %__MODULE__{}

  @doc "A trial of a policy."
  @spec new(Policy.t(), Settings.t(), [option()]) :: t()
  def new(policy, settings, options) do
    ledger = Keyword.get(options, :ledger, [])

    %__MODULE__{
      settings: settings,
      as: Keyword.fetch!(options, :as),
      named: Keyword.get(options, :named, fn _name, _at -> nil end),
      trial: Trial.new(policy),
      commands: Commands.new(Machine.new(settings, [])),
      ledger: ledger
    }
  end

  @doc """
  Another recording begins. `label` is what the recordings of one flight have in common; one that continues the last one keeps what is
  known of its vehicles, which are of `network`; nil: of the gateway's own.
  """
  @spec recording(t(), label :: String.t(), network :: String.t() | nil) :: t()
  def recording(trial, label, network \\ nil)
  def recording(%{label: label, network: network} = trial, label, network), do: %{trial | first: nil}

  def recording(trial, label, network),
    do: again(%{trial | label: label, network: network, first: nil, last: nil})

  @doc "The next frame or damaged part, and what was decided, in order."
  @spec push(t(), Frame.t() | MavCodec.Tlog.Damage.t()) :: {t(), [decision()]}
  def push(%{first: nil} = trial, %Frame{} = frame), do: trial |> begin(frame.at) |> next(frame)
  def push(trial, %Frame{} = frame), do: next(trial, frame)

  def push(trial, damage) do
    {commands, []} = Commands.push(trial.commands, damage)
    {%{trial | commands: commands}, []}
  end

  defp begin(%{last: last} = trial, at) do
    follows? = last == nil or (at - last > -@back_us and at - last < @next_us)
    trial = if follows?, do: trial, else: again(trial)
    %{trial | first: at, last: at}
  end

  defp again(trial) do
    machine = Machine.new(trial.settings, network: trial.network)

    %{
      trial
      | trial: Trial.again(trial.trial),
        commands: Commands.again(trial.commands, machine),
        pending: nil,
        transfers: %{}
    }
  end

  # A clock that goes back brings tokens of the future.
  defp next(%{last: last} = trial, %{at: at} = frame) when at < last - @back_us do
    next(%{trial | trial: Trial.again(trial.trial), last: at, pending: nil}, frame)
  end

  defp next(trial, frame) do
    {trial, of_ledger} = trial |> pending(frame.at) |> of_ledger(frame.at, [])
    {commands, found} = Commands.push(trial.commands, frame)

    {decisions, trial} =
      Enum.flat_map_reduce(found, %{trial | commands: commands, last: max(trial.last, frame.at)}, &of_frame/2)

    {trial, of_ledger ++ decisions}
  end

  # Those before a recording are of another one.
  defp pending(%{pending: nil} = trial, at),
    do: %{trial | pending: Enum.drop_while(trial.ledger, &(&1.at < at))}

  defp pending(trial, _at), do: trial

  defp of_ledger(%{pending: [%{at: at} = entry | rest]} = trial, now, decisions) when at <= now do
    {trial, decided} = envelope(%{trial | pending: rest}, entry)
    of_ledger(trial, now, decided ++ decisions)
  end

  defp of_ledger(trial, _now, decisions), do: {trial, Enum.reverse(decisions)}

  defp envelope(trial, %{id: id, at: at, envelope: %{"type" => type, "vehicle" => vehicle} = envelope})
       when is_binary(type) and is_binary(vehicle) do
    key = {id, at}
    trial = %{trial | passed: Map.put(trial.passed, key, vehicle)}
    snapshot = Machine.snapshots(trial.commands.machine)[vehicle]

    cond do
      snapshot == nil ->
        {trial, []}

      type in Intent.raw() ->
        {source, trial} = source(trial, envelope["source"], at)
        {seen(put_in(trial.transfers[vehicle], source), key), []}

      MapSet.member?(trial.judged, key) ->
        {trial, []}

      true ->
        {source, trial} = source(trial, envelope["source"], at)
        trial |> seen(key) |> command(Command.parse(envelope, at), snapshot, source, at)
    end
  end

  defp envelope(trial, _other), do: {count(trial, :malformed), []}

  defp seen(trial, key), do: %{trial | judged: MapSet.put(trial.judged, key)}

  defp command(trial, {:ok, command}, snapshot, source, at) do
    asked = %{snapshot: snapshot, at: at, source: source, sender: source.name, via: "ledger"}
    {judgement, inner} = Trial.command(trial.trial, command, asked)
    {%{trial | trial: inner}, [decision(judgement, asked, source.name, command.type)]}
  end

  defp command(trial, {:error, _errors}, _snapshot, _source, _at), do: {count(trial, :malformed), []}

  defp source(trial, name, at) when is_binary(name) do
    case trial.named.(name, at) do
      nil -> {trial.as.({:source, name}), %{trial | unnamed: MapSet.put(trial.unnamed, name)}}
      source -> {source, trial}
    end
  end

  defp source(trial, _none, _at), do: {trial.as.({:source, @gateway}), trial}

  defp of_frame(%{own?: true, class: class} = found, trial) do
    transfer = if class in @transfer_classes, do: trial.transfers[found.snapshot.id]

    cond do
      transfer != nil -> judge(found, trial, transfer, "#{@gateway} (#{transfer.name})")
      class not in @transfer_classes and covered?(trial, found.at) -> {[], count(trial, :in_ledger)}
      true -> judge(found, trial, trial.as.({:source, @gateway}), @gateway)
    end
  end

  defp of_frame(%{from: {system, component}} = found, trial) do
    who = "#{system}/#{component}"
    judge(found, trial, trial.as.({:station, who}), who)
  end

  defp covered?(%{ledger: [%{at: first} | _]}, at), do: first <= at
  defp covered?(_none, _at), do: false

  defp judge(found, trial, source, who) do
    asked = %{snapshot: found.snapshot, at: found.at, source: source, sender: who, via: "mavlink"}

    case Trial.message(trial.trial, found.message, asked) do
      {:free, inner} -> {[], %{trial | trial: inner}}
      {judgement, inner} -> {[decision(judgement, asked, who, found.name)], %{trial | trial: inner}}
    end
  end

  defp decision(judgement, asked, who, name) do
    Map.merge(judgement, %{
      at: asked.at,
      vehicle: asked.snapshot.id,
      who: who,
      role: asked.source.role,
      via: asked.via,
      name: name
    })
  end

  defp count(trial, what), do: %{trial | counts: Map.update(trial.counts, what, 1, &(&1 + 1))}

  @doc "What was not judged, by its reason (`t:Aerie.Fleet.Replay.Commands.reason/0`; `:in_ledger`: frames of the gateway that the ledger stands for; `:malformed`: commands of the ledger that cannot be read)."
  @spec skipped(t()) :: %{atom() => pos_integer()}
  def skipped(trial), do: Map.merge(trial.commands.skipped, trial.counts)

  @doc "Vehicles of the ledger's commands during the recordings that no recording has by that name, with the number of their commands."
  @spec missing(t()) :: %{String.t() => pos_integer()}
  def missing(%{passed: passed, judged: judged}) do
    Enum.frequencies(for {key, vehicle} <- passed, not MapSet.member?(judged, key), do: to_string(vehicle))
  end

  @doc "Names of the ledger whose role is not known."
  @spec unnamed(t()) :: [String.t()]
  def unnamed(trial), do: Enum.sort(trial.unnamed)

  @doc "The vehicles, frames and damaged parts of the recording, and why it cannot be one (nil if it is)."
  @spec summary(t()) :: map()
  def summary(%{commands: %{machine: machine}}), do: Machine.summary(machine)
end
