defmodule Aerie.Control.Policy.Rules.Role.Pilot do
  @moduledoc """
  What the permission `pilot` opens of that which needs `maintain` or `protection`:

  | what | as far as |
  |---|---|
  | heights and speeds of a flight, by parameters | the bounds of `MavCodec.Meaning.Pilot`, and limits of the policy |
  | moving home in flight | fence and limits allow its place |
  | removing the vehicle's fence, or replacing it | the policy has no limits, which it may stand for |
  | erasing the vehicle's logs | always |
  """

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Intent

  @instead [:maintain, :protection]

  @doc "Whether somebody with `pilot` needs none of the permissions that he lacks."
  @spec opens?(Policy.t(), Intent.t(), lacking :: [atom(), ...]) :: boolean()
  def opens?(policy, facts, lacking), do: lacking -- @instead == [] and opens?(policy, facts)

  defp opens?(_policy, %{type: "set_parameter", also: [], sets: [_ | _] = sets}),
    do: Enum.all?(sets, fn {name, value} -> MavCodec.Meaning.Pilot.within?(name, value) end)

  defp opens?(_policy, %{type: "set_home"}), do: true
  defp opens?(_policy, %{type: "erase_logs"}), do: true
  defp opens?(policy, %{type: "fence_upload"}), do: not limited?(policy)
  defp opens?(_policy, _another), do: false

  defp limited?(policy),
    do: Enum.any?([policy.fence, policy.max_altitude, policy.min_altitude, policy.max_altitude_msl])
end
