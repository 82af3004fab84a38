defmodule Aerie.Config.Keys.Router do
  @moduledoc "How frames go from one to the other."

  import Aerie.Config.Field, only: [field: 4, section: 3]

  alias Aerie.Config.Field

  @doc "The section `router`."
  @spec section() :: Field.t()
  def section do
    section(:router, "How frames go from one to the other.", [
      field(
        :between_vehicles,
        {:enum, [:auto, :all, :heartbeats, :none]},
        """
        What vehicles hear of what other vehicles say to everybody: all, heartbeats, none; auto: all where at most 8
        vehicles' ways are in a network, heartbeats up to 32, else none. What is addressed to a vehicle always goes there.
        """,
        default: :auto
      )
    ])
  end
end
