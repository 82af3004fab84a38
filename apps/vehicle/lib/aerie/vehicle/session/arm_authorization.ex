defmodule Aerie.Vehicle.Session.ArmAuthorization do
  @moduledoc """
  A vehicle asks before it arms (X13: PX4's COM_ARM_AUTH_REQ with the gateway's system id in COM_ARM_AUTH_ID), whatever
  the source of the order, a pilot's remote control included. A module with this behaviour decides; without one the
  answer is no.
  """

  alias Aerie.Base.Names
  alias Aerie.Vehicle.Command.Refusal
  alias MavCodec.Enums.{MavCmd, MavResult}
  alias MavCodec.Messages.CommandAck

  @request MavCmd.value(:MAV_CMD_ARM_AUTHORIZATION_REQUEST)
  @in_progress MavResult.value(:MAV_RESULT_IN_PROGRESS)
  @accepted MavResult.value(:MAV_RESULT_ACCEPTED)
  # A refusal may not last: a battery, a time of day.
  @not_now MavResult.value(:MAV_RESULT_TEMPORARILY_REJECTED)
  # For so long it may arm.
  @window_s 10

  @type decision :: :allow | Refusal.denial()

  @doc "Decides whether a vehicle may arm now."
  @callback decide(Names.gateway(), snapshot :: map(), now_us :: integer()) :: decision()

  @doc "The decision of a module; without one (nil) the vehicle may not arm."
  @spec decision(module() | nil, Names.gateway(), snapshot :: map()) :: decision()
  def decision(nil, _gateway, _snapshot), do: Refusal.deny(:no_policy_to_arm)
  def decision(module, gateway, snapshot), do: module.decide(gateway, snapshot, System.os_time(:microsecond))

  @doc "The command by which a vehicle asks."
  @spec request() :: non_neg_integer()
  def request, do: @request

  @doc "The answers: in progress, then the decision, for the component of the vehicle that asked."
  @spec answers(decision(), system :: pos_integer(), component :: non_neg_integer()) :: [CommandAck.t(), ...]
  def answers(decision, system, component) do
    ack = %CommandAck{command: @request, target_system: system, target_component: component}
    [%{ack | result: @in_progress, progress: 255}, answer(decision, ack)]
  end

  defp answer(:allow, ack), do: %{ack | result: @accepted, result_param2: @window_s}
  defp answer(_denied, ack), do: %{ack | result: @not_now}
end
