defmodule Aerie.Control.Policy.Clients.Trial do
  @moduledoc """
  A policy that is asked about commands of the past, in the order of their times: a pure value. It decides as `Aerie.Control.Policy.Clients.MavlinkPolicy`
  and `Aerie.Control.Commands.Pipeline` do, and carries along what a decision depends on besides the vehicle: how often each source commanded,
  the last item of each upload, and who is in charge.

  What a gateway refuses for its own state (an audit log that cannot be written, a deadline) is not decided here.
  """

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{Intent, ControlLease, Mavlink, Rate, Roles}
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Control.Policy.Mavlink.Writing
  alias Aerie.Vehicle.Command

  @enforce_keys [:policy]
  defstruct [:policy, rates: %{}, uploads: %{}, plans: %{}, aboard: %{}, leases: %{}]

  # Clients of one recording; their uploads are few.
  @max_uploads 1_000

  # What the rules ask of a vehicle, and what it is called.
  @needs %{
    condition: [:armed, :in_air],
    battery: [:battery],
    mode: [:mode],
    altitude: [:position, :home],
    geofence: [:position, :home],
    disarmed: [:armed]
  }

  @type t :: %__MODULE__{
          policy: Policy.t(),
          rates: %{{source :: String.t(), vehicle :: String.t()} => Rate.t()},
          uploads: %{term() => Mavlink.Upload.t()},
          plans: %{term() => Mavlink.Writing.RawPlan.t() | nil},
          aboard: %{term() => [Protocols.Mission.Item.t()] | nil},
          leases: %{String.t() => ControlLease.t() | nil}
        }

  @typedoc "`:snapshot` - of the vehicle at that time (`Aerie.Vehicle.Session.Core.snapshot/1`); `:at` - unix microseconds; `:sender` - who uploads; `:via` - the interface."
  @type asked :: %{
          snapshot: map(),
          at: integer(),
          source: Roles.source(),
          sender: term(),
          via: String.t()
        }

  @typedoc "`:lacking` - what the rule that denies asks for and nothing heard so far had told."
  @type judgement :: %{
          command: String.t(),
          decision: Policy.decision() | {:deny, :rate, String.t()},
          lacking: [atom()]
        }

  @doc "Nobody has commanded anything yet."
  @spec new(Policy.t()) :: t()
  def new(policy), do: %__MODULE__{policy: policy}

  @doc "A raw MAVLink message of a client. `:free` for one that only reads."
  @spec message(t(), struct(), asked()) :: {judgement() | :free, t()}
  def message(trial, message, asked) do
    case Mavlink.facts(message, Map.take(asked.snapshot, [:autopilot, :vehicle_type])) do
      :free ->
        {:free, trial}

      facts ->
        {facts, trial} = upload(trial, facts, message, asked)
        judge(trial, facts, Map.put(asked, :message, message))
    end
  end

  @doc "A command of the table."
  @spec command(t(), Command.t(), asked()) :: {judgement(), t()}
  def command(trial, command, asked), do: judge(trial, Intent.of(command), asked)

  @doc "Another recording begins: nothing of the last one counts in it."
  @spec again(t()) :: t()
  def again(trial), do: new(trial.policy)

  defp upload(trial, %{type: "mission_upload"} = facts, message, asked) do
    key = {asked.sender, asked.snapshot.id}
    {facts, item} = Mavlink.Upload.next(trial.uploads[key], message, facts)
    uploads = if map_size(trial.uploads) < @max_uploads, do: trial.uploads, else: %{}
    {facts, %{trial | uploads: Map.put(uploads, key, item)}}
  end

  defp upload(trial, facts, _message, _asked), do: {facts, trial}

  defp judge(trial, facts, %{snapshot: snapshot} = asked) do
    context = Context.seen(snapshot, trial.leases[snapshot.id], asked.source, asked.at)

    # As in a gateway, a command that a rule refuses has taken its token.
    {decision, trial} =
      case rate(trial, facts, asked) do
        {:ok, trial} -> decide(trial, facts, context, asked)
        denied -> {denied, trial}
      end

    {%{command: facts.type, decision: decision, lacking: lacking(decision, context)}, trial}
  end

  defp decide(trial, facts, context, asked) do
    with :allow <- Policy.decide(trial.policy, facts, context),
         {:allow, trial} <- written(trial, facts, context, asked),
         :allow <- Writing.enters(trial.policy, asked.snapshot, facts, context, aboard(trial, asked, 0)),
         {:ok, trial} <- in_charge(trial, facts, asked) do
      {:allow, trial}
    else
      {{:deny, _rule, _reason} = denied, trial} -> {denied, trial}
      denied -> {denied, trial}
    end
  end

  defp written(trial, facts, context, %{message: message, snapshot: snapshot} = asked) do
    with {type, part} <- Writing.plan(message, facts, snapshot) do
      key = {snapshot.id, type}
      about = {trial.policy, snapshot, context}
      before = trial.plans[{key, part}]
      {decision, plan, sent} = Writing.step(before, message, aboard(trial, asked, type), about, asked.at)

      aboard =
        case sent do
          :same -> trial.aboard
          nil -> Map.put(trial.aboard, key, nil)
          items -> Map.put(trial.aboard, key, items)
        end

      plans = if map_size(trial.plans) < @max_uploads, do: trial.plans, else: %{}
      {decision, %{trial | plans: Map.put(plans, {key, part}, plan), aboard: aboard}}
    else
      nil -> {:allow, trial}
    end
  end

  defp written(trial, _facts, _context, _command), do: {:allow, trial}

  # As the recording had it sent. What was aboard before, a gateway reads; here it counts as nothing.
  defp aboard(trial, %{snapshot: %{id: id}}, type) do
    fn ->
      case trial.aboard do
        %{{^id, ^type} => nil} -> :unknown
        %{{^id, ^type} => items} -> {:ok, items}
        _never_written -> {:ok, []}
      end
    end
  end

  defp rate(trial, %{ends_flight?: true}, _asked), do: {:ok, trial}

  defp rate(trial, facts, %{source: source, snapshot: %{id: id}, at: at}) do
    rate = Map.get(trial.rates, {source.name, id}, Rate.new())

    with {:ok, rate} <- Rate.take(rate, trial.policy, source.name, id, facts.type, at),
         do: {:ok, %{trial | rates: Map.put(trial.rates, {source.name, id}, rate)}}
  end

  defp in_charge(trial, %{control: nil}, _asked), do: {:ok, trial}

  defp in_charge(trial, %{control: change}, %{snapshot: %{id: id}} = asked) do
    lease = trial.leases[id]

    with {:ok, lease} <-
           ControlLease.change(lease, change, asked.source, asked.via, trial.policy.lease, asked.at),
         do: {:ok, %{trial | leases: Map.put(trial.leases, id, lease)}}
  end

  defp lacking(:allow, _context), do: []

  defp lacking({:deny, rule, _reason}, context),
    do: for(field <- Map.get(@needs, rule, []), Map.fetch!(context, field) == nil, do: field)
end
