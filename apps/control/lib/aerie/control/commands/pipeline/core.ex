defmodule Aerie.Control.Commands.Pipeline.Core do
  @moduledoc """
  The way of one command through every check to its result, as a pure value: `handle/3` takes what was found out and
  says what to do next.

      look ─▶ token ─▶ holder ─▶ ledger ─▶ judge ─▶ audit ─▶ set-points ─▶ claim ─▶ sending ─▶ send ─▶ result

  The last of the actions is a question, and its answer is the next event; or it ends the command (`:answer`, `:refuse`,
  `:finish`). Those before it are not answered.

  What refuses a command before the ledger admits it is not kept, because nothing was decided about the command: the
  ledger is only asked whether it knows the id, since a repetition has its result whatever would be decided now. What
  refuses it later is the result of its id. Nothing is sent before the ledger knows that it will be. If the ledger
  cannot be written, a command is denied, unless it holds the vehicle or brings it down, or the configuration allows it.
  """

  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.{Refusal, Result}
  alias Aerie.Control.Commands.Gateways
  alias Aerie.Control.Commands.Gateways.Sending
  alias Aerie.Control.Commands.Pipeline.Request
  alias Aerie.Control.Policy.{Intent, ControlLease}

  # For a claim that nobody waits for.
  @alone_ms 500

  # Why a gateway that was said to have the lease gave no command to the vehicle.
  @unheld ~w(unreachable holder claim unavailable vehicle)

  @enforce_keys [:request, :intent, :settings, :patience]
  defstruct @enforce_keys ++ [:snapshot, :asked, :refusal, :sending, :promise, :result, token?: false]

  @typedoc """
    * `ledger_required?` - nothing is sent while the ledger cannot be written
    * `urgent_ms` - how long a command that holds a vehicle or brings it down waits for the ledger and the audit log;
      `record_ms` - how long other commands wait for them
    * `shared?` - whether there may be other gateways
  """
  @type settings :: %{
          ledger_required?: boolean(),
          urgent_ms: pos_integer(),
          record_ms: pos_integer(),
          shared?: boolean()
        }

  @typedoc """
    * `:patience` - how long it waits for ledger and audit log (ms)
    * `:asked` - what the ledger was asked; `:refusal` - what follows if it does not know the id
    * `:promise` - which gateways do not send it again; nil where no other one can hold the vehicle
    * `:token?` - whether it took a token of its source's rate
  """
  @type t :: %__MODULE__{
          request: Request.t(),
          intent: Intent.t(),
          settings: settings(),
          patience: pos_integer(),
          snapshot: map() | nil,
          asked: :known | :admit | nil,
          refusal: action() | nil,
          sending: Sending.t() | nil,
          promise: :fleet | :gateway | :urgent | nil,
          result: Result.t() | nil,
          token?: boolean()
        }

  @typedoc "`us`: the time of day (unix microseconds); `ms`: of a clock that never jumps."
  @type now :: %{us: integer(), ms: integer()}

  @type event ::
          :start
          | :waited
          | {:seen, snapshot :: map() | nil, :allow | Refusal.denial()}
          | {:token, :ok | Refusal.denial()}
          | {:holder, Sending.holder()}
          | {:known, :new | :in_flight | {:stored, Result.t()} | Refusal.denial() | {:error, String.t()}}
          | {:judged, {:audit, required? :: boolean()} | :allow | :no_policy | Refusal.denial()}
          | {:setpoints, :ok | Refusal.denial()}
          | {:claimed, :ok | {:taken, map()} | {:error, String.t()}}
          | {:sending, :ok | Refusal.denial() | {:error, String.t()}}
          | {:result, Result.t()}
          | {:lease, {:ok, ControlLease.t() | nil} | Refusal.denial()}

  @typedoc """
    * `:look` - finds the vehicle, and whether its sender may do anything like it
    * `{:ask, :known | :admit}` - asks the ledger whether it knows the id, and `:admit` that it keeps the command if not
    * `{:refuse, denial, stored?}` - ends it, as the result of its id if `stored?`
    * `{:answer, result}` - ends a repetition; `{:finish, result}` - ends a command that was admitted
  """
  @type action ::
          :look
          | :take_token
          | :put_back_token
          | :holder
          | {:wait, ms :: pos_integer()}
          | {:ask, :known | :admit}
          | :judge
          | {:audit, required? :: boolean()}
          | :setpoints
          | {:claim, timeout_ms :: pos_integer()}
          | {:sending, :safe | :never}
          | :commanded
          | :execute
          | :pass_on
          | {:change_lease, ControlLease.change()}
          | {:announce, Result.t()}
          | {:refuse, Refusal.denial(), stored? :: boolean()}
          | {:answer, Result.t()}
          | {:finish, Result.t()}

  @doc "A command that has come."
  @spec new(Request.t(), settings()) :: t()
  def new(request, settings) do
    intent = Request.intent(request)
    patience = if intent.ends_flight?, do: settings.urgent_ms, else: settings.record_ms
    %__MODULE__{request: request, intent: intent, settings: settings, patience: patience}
  end

  @doc "What follows from an event."
  @spec handle(t(), event(), now()) :: {t(), [action(), ...]}
  def handle(core, :start, _now), do: {core, [:look]}

  def handle(core, {:seen, nil, _admission}, _now),
    do: refuse(core, Refusal.deny(:no_vehicle, id: core.request.command.vehicle))

  def handle(core, {asked, {:deny, _rule, _reason} = denial}, _now)
      when asked in [:token, :judged, :setpoints],
      do: refuse(core, denial)

  # Before anything is remembered of it, so that a sender without permissions fills neither rates nor the ledger.
  def handle(core, {:seen, _snapshot, {:deny, _rule, _reason} = denial}, _now), do: refuse(core, denial)

  # Commands that bring a vehicle down are exempt, so that a stuck key cannot exhaust the rate limit.
  def handle(%{intent: %{ends_flight?: true}} = core, {:seen, snapshot, :allow}, now),
    do: find_holder(%{core | snapshot: snapshot}, now)

  def handle(core, {:seen, snapshot, :allow}, _now), do: {%{core | snapshot: snapshot}, [:take_token]}
  def handle(core, {:token, :ok}, now), do: find_holder(%{core | token?: true}, now)

  def handle(core, {:holder, holder}, now) do
    case Sending.handle(core.sending, {:holder, holder, now.ms}) do
      {sending, :go_on} -> admit(%{core | sending: sending}, now)
      {_over, {:pass_on, name}} -> admit(reached_by(core, name), now)
      {_same, {:again, ms}} when core.asked == :known -> {core, [{:wait, ms}]}
      {_same, {:again, _ms}} -> {%{core | asked: :known}, [{:ask, :known}]}
      {sending, :claim} -> {%{core | sending: sending}, [{:claim, claim_ms(core, sending)}]}
      {_over, {:send, promise}} -> send_off(%{core | promise: promise})
      {_over, {:refuse, denial}} -> refuse(core, denial)
    end
  end

  def handle(core, :waited, _now), do: {core, [:holder]}

  def handle(core, {:known, {:stored, result}}, _now), do: repeated(core, {:answer, result})
  def handle(core, {:known, :in_flight}, _now), do: repeated(core, {:answer, lost(core.request.command)})

  def handle(core, {:known, {:deny, :id, _reason} = denial}, _now),
    do: repeated(core, {:refuse, denial, false})

  # It is not known yet who holds the vehicle.
  def handle(%{asked: :known, refusal: nil} = core, {:known, _new_or_error}, _now), do: {core, [:holder]}
  def handle(%{asked: :known} = core, {:known, _new_or_error}, _now), do: {core, [core.refusal]}
  def handle(core, {:known, :new}, _now), do: {core, [:judge]}

  def handle(core, {:known, {:error, reason}}, _now) do
    if unrecorded?(core),
      do: {core, [:judge]},
      else: {core, [{:refuse, unrecorded(core, reason), false}]}
  end

  def handle(core, {:judged, {:audit, required?}}, _now), do: {core, [{:audit, required?}]}
  def handle(core, {:judged, :allow}, _now), do: {core, [:setpoints]}

  def handle(core, {:judged, :no_policy}, _now), do: refuse(core, Refusal.deny(:no_policy))

  def handle(%{request: %{command: command}} = core, {:setpoints, :ok}, now) do
    cond do
      Command.expired?(command, now.us) -> refuse(core, Refusal.deny(:late))
      core.sending == nil -> {core, [{:sending, Request.retry(core.request)}]}
      true -> {core, [:holder]}
    end
  end

  def handle(core, {:claimed, claimed}, _now) do
    case Sending.handle(core.sending, {:claimed, claimed}) do
      {sending, :go_on} -> {%{core | sending: sending}, [{:sending, Request.retry(core.request)}]}
      {_over, {:known, claim}} -> finish(core, claimed_result(core, claim))
      {_over, {:refuse, denial}} -> refuse(core, denial)
    end
  end

  def handle(core, {:sending, :ok}, _now), do: held(core)

  def handle(core, {:sending, {:deny, :ledger, reason} = denial}, now) do
    # It is unknown whether it was done before.
    if Request.retry(core.request) == :never,
      do: refuse(core, denial),
      else: handle(core, {:sending, {:error, reason}}, now)
  end

  def handle(core, {:sending, {:error, reason}}, _now),
    do: if(unrecorded?(core), do: held(core), else: refuse(core, unrecorded(core, reason)))

  def handle(%{snapshot: %{via: via} = snapshot} = core, {:result, result}, _now) when via != nil do
    if again?(core, result),
      do: carry_out(%{core | snapshot: %{snapshot | via: nil, heard_here?: false}}),
      else: done(core, result)
  end

  def handle(%{intent: %{control: nil}} = core, {:result, result}, _now), do: done(core, result)

  # A release succeeds even if the vehicle does not answer.
  def handle(%{intent: %{control: change}} = core, {:result, result}, _now) do
    if result.status in [:accepted, :completed] or change == :release,
      do: {%{core | result: result}, [{:change_lease, change}]},
      else: done(core, result)
  end

  def handle(core, {:lease, {:ok, _lease}}, _now), do: done(core, core.result)

  def handle(core, {:lease, {:deny, :lease, _reason} = denial}, _now),
    do: done(core, Refusal.result(core.request.command.id, denial))

  @doc "The result of a command whose task died."
  @spec lost(Command.t()) :: Result.t()
  def lost(command) do
    complete(Refusal.result(command.id, Refusal.ended(:interrupted)), command)
  end

  defp find_holder(%{settings: %{shared?: false}} = core, now), do: admit(core, now)
  defp find_holder(%{snapshot: %{via: via}} = core, now) when via != nil, do: admit(core, now)

  defp find_holder(%{request: request, intent: intent} = core, now) do
    sending = Sending.new(now.ms + core.patience, request.via == "nats", intent.ends_flight?)
    {%{core | sending: sending}, [:holder]}
  end

  # Another gateway holds the vehicle, which is heard here; it claims the command.
  defp reached_by(core, name),
    do: %{core | sending: nil, snapshot: Gateways.reached_by(core.snapshot, name)}

  defp admit(%{request: %{command: command, change: change}, snapshot: snapshot} = core, now) do
    cond do
      match?(%{remote_request: nil}, change) and snapshot.via != nil ->
        refuse(core, Refusal.deny(:elsewhere, via: snapshot.via))

      Command.expired?(command, now.us) ->
        refuse(core, Refusal.deny(:late))

      true ->
        {%{core | asked: :admit}, [{:ask, :admit}]}
    end
  end

  # What was admitted keeps its refusal; nothing else is kept.
  defp refuse(core, denial) do
    refusal = {:refuse, denial, core.asked == :admit}

    if core.asked == nil,
      do: {%{core | asked: :known, refusal: refusal}, [{:ask, :known}]},
      else: {core, [refusal]}
  end

  defp repeated(%{token?: true} = core, action), do: {core, [:put_back_token, action]}
  defp repeated(core, action), do: {core, [action]}

  defp unrecorded?(core), do: core.intent.ends_flight? or not core.settings.ledger_required?

  defp unrecorded(core, error),
    do: Refusal.deny(:unrecorded, command: core.request.command.type, error: error)

  defp claim_ms(core, %{lease: lease, urgent?: urgent?}) when lease == :alone or urgent?,
    do: min(@alone_ms, core.patience)

  defp claim_ms(core, _sending), do: core.patience

  defp claimed_result(_core, %{result: %Result{} = result}), do: result

  defp claimed_result(core, %{by: by}) do
    Refusal.result(core.request.command.id, Refusal.ended(:of_another_gateway, by: by))
  end

  defp held(%{sending: nil} = core), do: send_off(core)
  defp held(core), do: {core, [:holder]}

  defp send_off(core) do
    {core, actions} = carry_out(core)
    {core, [:commanded | actions]}
  end

  defp carry_out(%{snapshot: %{via: via}} = core) when via != nil, do: {core, [:pass_on]}
  defp carry_out(%{intent: %{control: nil}} = core), do: {core, [:execute]}

  # A vehicle that has an operator of its own (X15) is asked first.
  defp carry_out(%{intent: %{control: change}, snapshot: snapshot} = core) do
    if snapshot.status != :lost and get_in(snapshot.groups, [:operator, :data, :system]) != nil do
      {core, [:execute]}
    else
      {%{core | result: Result.new(core.request.command.id, :completed)}, [{:change_lease, change}]}
    end
  end

  # It was passed on in vain: the vehicle is heard here, the command holds it or brings it down, and the gateway that
  # has the lease did not answer or does not have it any more.
  defp again?(%{intent: %{ends_flight?: true}, snapshot: %{heard_here?: true}}, result),
    do: result.status == :unknown or result.details["rule"] in @unheld

  defp again?(_core, _result), do: false

  # The other gateways learn of the result, and it says what holds.
  defp done(%{promise: nil} = core, result), do: finish(core, result)

  defp done(%{promise: promise} = core, result) do
    once = if promise == :urgent, do: "gateway", else: Atom.to_string(promise)
    result = %{result | details: Map.put(result.details, "once", once)}
    {core, actions} = finish(core, result)
    {core, [{:announce, result} | actions]}
  end

  defp finish(core, result), do: {core, [{:finish, complete(result, core.request.command)}]}

  defp complete(result, command) do
    details = Map.merge(result.details, %{"vehicle" => command.vehicle, "type" => command.type})
    %{result | details: details}
  end
end
