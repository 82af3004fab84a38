defmodule Aerie.Control.Commands.Record do
  @moduledoc """
  What is kept of a command: audit log, metrics, telemetry.

  | event | measurements | metadata |
  |---|---|---|
  | `[:aerie, :command, :received]` | `count` (1) | `gateway`, `type` |
  | `[:aerie, :command, :refused]` | `count` (1) | `gateway`, `vehicle`, `type`, `source`, `rule`, `reason` |
  | `[:aerie, :command, :done]` | `count` (1), `us` (since it came; nil for one of an earlier run) | `gateway`, `id`, `vehicle`, `type`, `result`, `reason` |

  What can come in floods (rates, malformed commands, ids that are used) is counted each time, and in the audit log once in five
  seconds for each source and rule: a flood must not push the rest out of the log. All refusals of somebody who
  may nothing are summed up there (`Aerie.Control.Policy.Audit.Refusals`).
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.{Refusal, Result, Types}
  alias Aerie.Control.Commands.Metrics
  alias Aerie.Control.Commands.Pipeline.Request
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{Audit, Intent, Roles}

  @quiet_ms 5_000
  @floods [:rate, :busy, :id, :vehicle, :holder, :deadline, :malformed, :signature, :size]

  @doc "A command has come."
  @spec received(Names.gateway(), type :: term()) :: :ok
  def received(gateway, type) do
    type = type(type)
    Metrics.received(gateway, type)
    :telemetry.execute([:aerie, :command, :received], %{count: 1}, %{gateway: gateway, type: type})
  end

  @doc "The policy allowed a command: counted as for MAVLink of clients."
  @spec allowed(Names.gateway()) :: :ok
  def allowed(gateway), do: decided(gateway, :allow, nil)

  defp decided(gateway, decision, rule) do
    _ = Store.count(gateway, {:policy, decision, rule})
    :ok
  end

  @doc "A decision as the audit log has it: a command is allowed, unless it says otherwise."
  @spec decision(Request.t()) :: map()
  def decision(%{command: command} = request) do
    %{
      "type" => "decision",
      "decision" => "allow",
      "id" => command.id,
      "vehicle" => command.vehicle,
      "command" => command.type,
      "params" => Command.plain(command)["params"],
      "source" => request.source.name,
      "role" => request.source.role,
      "via" => request.via,
      "says" => request.says
    }
  end

  @doc "A command is not carried out; gives its result."
  @spec refused(Names.gateway(), Request.t(), Refusal.denial()) :: Result.t()
  def refused(gateway, %{command: command} = request, {:deny, rule, reason} = denial) do
    result = Refusal.result(command.id, denial)
    flood? = rule in @floods and not Audit.Refusals.nobody?(request.source)

    if not flood? or Store.claim(gateway, {__MODULE__, rule, request.source.name}, @quiet_ms) do
      Audit.refusal(gateway, request.source, denial, Map.put(decision(request), "result", result.status))
    end

    if rule in [:audit | Policy.rules()], do: decided(gateway, :deny, rule)
    count(gateway, command.vehicle, command.type, request.source.name, rule, reason)
    Metrics.executed(gateway, command.type, result.status, nil)
    %{result | details: Map.merge(result.details, %{"vehicle" => command.vehicle, "type" => command.type})}
  end

  @doc "Records a malformed message or one from a sender without rights: the rule is `malformed`, `signature` or `size`."
  @spec turned_away(
          Names.gateway(),
          map(),
          Roles.source() | nil,
          via :: String.t(),
          Refusal.denial()
        ) ::
          :ok
  def turned_away(gateway, envelope, source, via, {:deny, rule, reason} = denial) do
    type = type(envelope["type"])
    received(gateway, type)
    vehicle = envelope["vehicle"]
    vehicle = if is_binary(vehicle) and Store.vehicle(gateway, vehicle) != nil, do: vehicle
    name = source && source.name

    if Audit.Refusals.nobody?(source) or Store.claim(gateway, {__MODULE__, rule, name, via}, @quiet_ms) do
      entry = %{"type" => "decision", "vehicle" => vehicle, "command" => type, "source" => name, "via" => via}
      Audit.refusal(gateway, source, denial, entry)
    end

    count(gateway, vehicle, type, name, rule, reason)
  end

  @doc "A command has its result. `us`: microseconds since it came, nil for one of an earlier run."
  @spec done(Names.gateway(), Command.t(), Result.t(), us :: non_neg_integer() | nil) :: :ok
  def done(gateway, command, result, us) do
    _ =
      Audit.append(gateway, %{
        "type" => "result",
        "id" => result.id,
        "vehicle" => command.vehicle,
        "command" => command.type,
        "source" => command.source,
        "result" => result.status,
        "reason" => result.reason
      })

    Metrics.executed(gateway, command.type, result.status, us)

    :telemetry.execute([:aerie, :command, :done], %{count: 1, us: us}, %{
      gateway: gateway,
      id: result.id,
      vehicle: command.vehicle,
      type: command.type,
      result: result.status,
      reason: result.reason
    })
  end

  defp count(gateway, vehicle, type, source, rule, reason) do
    Metrics.refused(gateway, type, rule)

    :telemetry.execute([:aerie, :command, :refused], %{count: 1}, %{
      gateway: gateway,
      vehicle: vehicle,
      type: type,
      source: source,
      rule: rule,
      reason: reason
    })
  end

  # Client-supplied names must not become metric labels.
  defp type(name),
    do: if(name in Intent.raw() or match?({:ok, _type}, Types.fetch(name)), do: name, else: "unknown")
end
