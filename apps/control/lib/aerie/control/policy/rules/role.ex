defmodule Aerie.Control.Policy.Rules.Role do
  @moduledoc """
  The source must have the permission that the command needs (`Aerie.Control.Policy.Roles`). Moving home or the origin
  of a vehicle that may be flying changes where it returns to and what its heights are measured from: that needs
  `protection` as well. A vehicle with MSP is armed and steered by channels in the place of its pilot's, which needs
  `receiver`; `motors` is for turning its motors. One whose firmware is not known may be such a vehicle, but `rtl` and
  `hold` do not need it there. `pilot` opens some of what needs `maintain` or `protection`:

  | what | as far as |
  |---|---|
  | heights and speeds of a flight, by parameters | the bounds of `MavCodec.Meaning.Pilot`, and limits of the policy |
  | moving home in flight | fence and limits allow its place |
  | removing the vehicle's fence, or replacing it | the policy has no limits, which it may stand for |
  | erasing the vehicle's logs | always |
  """

  @behaviour Aerie.Control.Policy.Rules.Rule

  alias Aerie.Control.Policy.FlightPath.Shaping
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{Intent, Roles}
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Vehicle.Command.{Refusal, Type}
  alias Aerie.Vehicle.Firmware
  alias MavCodec.Meaning.Pilot

  @by_channels ~w(arm set_mode rtl hold rc_override manual_control)
  # What holds a vehicle or brings it home is not kept from one that has not said yet what it is.
  @unknown @by_channels -- ~w(rtl hold)
  # The permissions in whose place `pilot` may be.
  @instead [:maintain, :protection]

  @impl Aerie.Control.Policy.Rules.Rule
  def check(policy, facts, %{source: source} = context) do
    case lacking(policy, facts, context) do
      nil -> if Roles.allowed?(source, :protection), do: :ok, else: Shaping.check(policy, facts, context)
      {_permission, denial} -> denial
    end
  end

  @doc "The first permission that a source lacks, and the refusal; nil if it has all."
  @spec lacking(Policy.t() | map(), Intent.t(), Context.t()) :: {Type.permission(), Refusal.denial()} | nil
  def lacking(policy, facts, %{source: source} = context) do
    needed =
      [facts.permission | facts.also] ++
        limited(policy, facts) ++ aloft(facts, context) ++ by_channels(facts, context)

    lacking = Enum.reject(needed, &Roles.allowed?(source, &1))
    opens? = lacking != [] and lacking -- @instead == [] and pilot_may?(policy, facts)

    with [permission | _more] <- if(opens? and Roles.allowed?(source, :pilot), do: [], else: lacking) do
      needed = "#{permission}#{if opens?, do: " or pilot"}#{guards(facts, permission)}"
      held = "#{held(permission, source)}#{because(facts, permission)}"
      {permission, Refusal.deny(:permission, command: Intent.label(facts), permission: needed, held: held)}
    else
      [] -> nil
    end
  end

  defp pilot_may?(_policy, %{type: "set_parameter", also: [], sets: [_ | _] = sets}),
    do: Enum.all?(sets, fn {name, value} -> Pilot.within?(name, value) end)

  defp pilot_may?(_policy, %{type: type}) when type in ["set_home", "erase_logs"], do: true
  defp pilot_may?(policy, %{type: "fence_upload"}), do: not limits?(policy)
  defp pilot_may?(_policy, _another), do: false

  defp limits?(policy),
    do: Enum.any?([policy.fence, policy.max_altitude, policy.min_altitude, policy.max_altitude_msl])

  # What a vehicle believes of where it is, and of its battery, leads it around a fence and a limit.
  defp limited(policy, %{type: "sensor_input"}), do: if(limits?(policy), do: [:inputs], else: [])
  defp limited(_policy, _facts), do: []

  defp aloft(%{type: type}, context) when type in ["set_home", "set_origin"] do
    flying? = if context.in_air == nil, do: context.armed != false, else: context.in_air
    if flying?, do: [:protection], else: []
  end

  defp aloft(_facts, _context), do: []

  # Not a vehicle that was heard, but a description that leaves its firmware open.
  defp by_channels(_facts, %{autopilot: nil}), do: []

  defp by_channels(%{type: type}, %{autopilot: firmware}) do
    case {type, Firmware.reading(firmware).steered_by} do
      {_any, :commands} -> []
      {"motor_test", _channels} -> [:motors]
      {_any, :channels} when type in @by_channels -> [:receiver]
      {_any, :either} when type in @unknown -> [:receiver]
      _other -> []
    end
  end

  defp because(%{reasons: reasons}, lacking), do: if(reasons[lacking], do: ": " <> reasons[lacking], else: "")

  # What a command of the table needs is in its description.
  defp guards(%{label: nil}, _lacking), do: ""
  defp guards(_facts, lacking), do: with(text when text != "" <- Roles.guards(lacking), do: " (#{text})")

  defp held(_lacking, nil), do: Refusal.text(:nobody_signed_in)

  defp held(lacking, %{name: name, role: role}) do
    if lacking in Roles.own(),
      do: Refusal.text(:not_given, source: name, role: role),
      else: Refusal.text(:not_in_role, source: name, role: role)
  end
end
