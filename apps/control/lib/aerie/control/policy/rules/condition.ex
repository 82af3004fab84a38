defmodule Aerie.Control.Policy.Rules.Condition do
  @moduledoc """
  Some commands are allowed only while the vehicle is armed or not, in the air or not. On the ground, what may make the
  vehicle take off or arm must meet the conditions of `takeoff` and `arm` as well.
  """

  @behaviour Aerie.Control.Policy.Rules.Rule

  alias Aerie.Control.Policy.Intent
  alias Aerie.Vehicle.Command.Refusal

  @typedoc "What must be so; nil: either."
  @type condition :: %{armed: boolean() | nil, in_air: boolean() | nil}

  # The workshop's commands: in the air they stop motors, move the attitude's zero or take the receiver away.
  @workshop ~w(reboot reset_params motor_test rx_pair calibrate calibrate_position calibrate_accept)

  @doc "The commands that need a vehicle disarmed on the ground, unless the configuration has an entry for them."
  @spec workshop() :: [String.t()]
  def workshop, do: @workshop

  @doc "The conditions without a configuration. What is not known does not meet them."
  @spec defaults() :: %{String.t() => condition()}
  def defaults, do: Map.new(@workshop, &{&1, %{armed: false, in_air: false}})

  @impl Aerie.Control.Policy.Rules.Rule
  def check(policy, facts, context) do
    for(type <- Intent.types(facts, context), condition = policy.conditions[type], do: condition)
    |> Enum.find_value(:ok, fn condition ->
      with :ok <- state(facts, :armed, condition.armed, context.armed),
           :ok <- state(facts, :in_air, condition.in_air, context.in_air),
           do: nil
    end)
  end

  defp state(_facts, _what, nil, _is), do: :ok
  defp state(_facts, _what, must, must), do: :ok

  defp state(facts, what, must, nil),
    do: Refusal.deny(:condition_unknown, command: Intent.label(facts), state: word(what, must))

  defp state(facts, what, must, is),
    do: Refusal.deny(:condition, command: Intent.label(facts), state: word(what, must), is: word(what, is))

  defp word(:armed, true), do: "armed"
  defp word(:armed, false), do: "disarmed"
  defp word(:in_air, true), do: "in the air"
  defp word(:in_air, false), do: "on the ground"
end
