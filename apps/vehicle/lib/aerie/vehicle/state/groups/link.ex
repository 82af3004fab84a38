defmodule Aerie.Vehicle.State.Groups.Link do
  @moduledoc "How the vehicle is heard, from all its frames (`Aerie.Vehicle.Services.Links.Reception`)."

  alias Aerie.Vehicle.State.Group

  use Group,
    name: :link,
    title: "How the vehicle is heard.",
    sampling: {:aggregate, 0.2, %{}, 60.0},
    messages: [],
    fields: [
      {:status, {:one_of, ~w(online stale lost)}, nil, "online, stale, lost", "all frames of the autopilot"},
      {:frames_per_s, 1, "1/s", "received frames", "all frames of the vehicle"},
      {:bytes_per_s, 0, "B/s", "received bytes", "all frames of the vehicle"},
      {:links, {:list, :text}, nil, "a list of the links that hear the vehicle, the latest first",
       "all frames of the vehicle"}
    ]
end
