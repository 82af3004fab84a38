defmodule Aerie.Vehicle.Snapshot.Readiness.Points do
  @moduledoc "The points of a vehicle's readiness in their order, its words, and what is shown of it."

  alias Aerie.Base.Json.Object

  # Name, title, what to do if it is not ready.
  @points [
    link: {"Link", "Bring it nearer, or check its radio and antennas."},
    ground: {"On the ground", "Land it first."},
    battery: {"Battery", "Change or charge the battery."},
    gps: {"GPS", "Give it a free view of the sky, and wait."},
    home: {"Home", "Wait until it has set its home, or set it."},
    arming: {"Arming checks", "Mend what the vehicle names."},
    mode: {"Mode", "Set this mode first; a take-off sets it by itself."},
    fence: {"Fence", "Wait until the fence that is wanted is aboard, or send it."},
    mission: {"Mission", "Wait until the mission that is wanted is aboard, or send it."},
    charge: {"In charge", "Ask the operator in charge, or take over."},
    boot: {"Since start", "Wait until it has settled."}
  ]

  @states [:ready, :check, :unknown, :not_ready]

  @point Object.fields([
           {:name, {:one_of, Keyword.keys(@points)}, nil, "the point"},
           {:title, :text, nil, "the same for people"},
           {:state, {:one_of, @states}, nil, "its state"},
           {:text, :text, nil, "what is the matter, for people"},
           {:todo, :text, nil, "what to do; null if nothing"}
         ])

  @fields Object.fields([
            {:state, {:one_of, @states}, nil,
             "ready; check: it may take off, but something is to be looked at; not_ready; unknown"},
            {:points, {:list, {:object, @point}}, nil, "in a fixed order:"}
          ])

  @doc "Each with its title and what to do if it is not ready."
  @spec all() :: [{name :: atom(), {title :: String.t(), todo :: String.t()}}, ...]
  def all, do: @points

  @doc "The words, the best first: that of a vehicle is the last one that a point has."
  @spec states() :: [atom(), ...]
  def states, do: @states

  @doc "What is shown of a vehicle's readiness."
  @spec fields() :: [Object.t()]
  def fields, do: @fields
end
