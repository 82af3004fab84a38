defmodule Aerie.Policy.Arming do
  @moduledoc """
  The answer to a vehicle that asks before it arms (X13: PX4's COM_ARM_AUTH_REQ with the gateway's system id in COM_ARM_AUTH_ID),
  whoever told it to arm: a pilot's remote control, too. The policy decides as about `arm`, but for roles and rates, because who
  told it is not known.
  """

  alias Aerie.{Names, Policy}
  alias Aerie.Policy.{Audit, Context, Facts, Lease, Roles}
  alias MavCodec.Enums.{MavCmd, MavResult}
  alias MavCodec.Messages.CommandAck

  @request MavCmd.value(:MAV_CMD_ARM_AUTHORIZATION_REQUEST)
  @in_progress MavResult.value(:MAV_RESULT_IN_PROGRESS)
  @accepted MavResult.value(:MAV_RESULT_ACCEPTED)
  # What is refused now may be allowed later: a battery, a time of day.
  @not_now MavResult.value(:MAV_RESULT_TEMPORARILY_REJECTED)
  # For so long it may arm.
  @window_s 10

  @doc "The command by which a vehicle asks."
  @spec request() :: non_neg_integer()
  def request, do: @request

  @doc "What the policy says about a vehicle that would arm now; it is in the audit log then."
  @spec decide(Names.gateway(), map(), now :: integer()) :: :allow | {:deny, atom(), String.t()}
  def decide(gateway, snapshot, now) do
    decision =
      case Policy.Store.get(gateway) do
        nil -> {:deny, :policy, "the gateway has no policy"}
        policy -> judge(policy, Context.of(gateway, snapshot, nil, now))
      end

    entry = %{
      "type" => "decision",
      "command" => "arm",
      "vehicle" => snapshot.id,
      "via" => "arm authorization"
    }

    Audit.note(gateway, Map.merge(entry, told(decision)))
    decision
  end

  # As whoever is in charge: the rule about that asks only whether somebody has to be.
  defp judge(policy, context) do
    name = with %Lease{holder: holder} <- context.lease, do: holder
    source = Roles.principal(:vehicle, name || "the vehicle", :admin)
    Policy.decide(policy, Facts.named("arm"), %{context | source: source})
  end

  defp told(:allow), do: %{"decision" => "allow"}
  defp told({:deny, rule, reason}), do: %{"decision" => "deny", "rule" => rule, "reason" => reason}

  @doc "The answers: that it is looked at, then the decision, for the component of the vehicle that asked."
  @spec answers(:allow | {:deny, atom(), String.t()}, system :: pos_integer(), component :: non_neg_integer()) ::
          [CommandAck.t(), ...]
  def answers(decision, system, component) do
    ack = %CommandAck{command: @request, target_system: system, target_component: component}
    [%{ack | result: @in_progress, progress: 255}, answer(decision, ack)]
  end

  defp answer(:allow, ack), do: %{ack | result: @accepted, result_param2: @window_s}
  defp answer(_denied, ack), do: %{ack | result: @not_now}
end
