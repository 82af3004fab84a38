defmodule FleetWeb.API.Parameters do
  @moduledoc "The parameters that queries of `/api` may have, for `docs/openapi.json`."

  @texts %{type: :string}

  @parameters %{
    limit: {%{type: :integer, minimum: 1, maximum: 1000, default: 100}, "How many, the latest ones."},
    since: {@texts, "Only those after this time: ISO 8601 with its offset, or unix seconds."},
    wait:
      {%{type: :integer, minimum: 0, maximum: 20},
       "How many seconds to wait for the result; then 202, and the command goes on."},
    timeout: {%{type: :integer, minimum: 1, maximum: 3600}, "How many seconds the transfer may take."},
    format:
      {@texts,
       "The form of the text: json, plan, waypoints, mission, param, params or txt, whichever the resource has."},
    id: {@texts, "Id of the command, for asking for it again."},
    unknown: {%{enum: ~w(skip refuse)}, "What to do with parameters that the vehicle does not have."},
    force:
      {%{type: :boolean, default: false}, "Sends a fence even if the vehicle in flight breaches it at once."},
    component:
      {%{type: :integer, minimum: 1, maximum: 255},
       "The component whose parameters are meant, such as 100, a camera; without it the autopilot."},
    version: {%{type: :integer}, "The version that this is meant for."},
    tag: {@texts, "Only vehicles with this tag."},
    list: {@texts, "Lists a folder."},
    crc: {@texts, "Gives the checksum."}
  }

  @doc "Schema and meaning of each."
  @spec all() :: %{atom() => {map(), String.t()}}
  def all, do: @parameters
end
