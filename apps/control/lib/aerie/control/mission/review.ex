defmodule Aerie.Control.Mission.Review do
  @moduledoc "The review of plans by the policy (`Aerie.Control.Policy.Mavlink.Review`)."

  alias Aerie.Control.Policy.Mavlink.Review

  defdelegate plan(policy, items, type, vehicle, context), to: Review
  defdelegate place(item, vehicle), to: Review
end
