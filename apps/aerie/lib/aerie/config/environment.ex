defmodule Aerie.Config.Environment do
  @moduledoc """
  Environment variables that override the file: `AERIE_` and the key's path in capitals, joined by `_`.

  `nats.url` is `AERIE_NATS_URL`, `mavlink.system_id` is `AERIE_MAVLINK_SYSTEM_ID`, `sampling.groups.gps.hz` is
  `AERIE_SAMPLING_GROUPS_GPS_HZ`. A list or a map is given as YAML or JSON text; a list of words also with commas.
  """

  alias Aerie.Config.{Keys, Yaml}
  alias Aerie.Settings.Schema

  @doc "The variable of a key, from its path."
  @spec name(Schema.path()) :: String.t()
  def name(path), do: "AERIE_" <> Enum.map_join(path, "_", &String.upcase/1)

  @doc "The overrides in `env`: path, text and the variable's name. Empty variables count as not set."
  @spec overrides(%{String.t() => String.t()}) :: [
          {Schema.path(), {:text, String.t(), function()}, String.t()}
        ]
  def overrides(env) do
    for {path, _field} <- Schema.leaves(Keys.fields()),
        text = Map.get(env, name(path), ""),
        text != "" do
      {path, {:text, String.trim(text), &Yaml.parse_value/1}, "environment variable " <> name(path)}
    end
  end

  @doc "Warnings for variables that begin like a section (`AERIE_NATS_…`) but match no key."
  @spec warnings(%{String.t() => String.t()}) :: [String.t()]
  def warnings(env) do
    paths = Enum.map(Schema.leaves(Keys.fields()), &elem(&1, 0))
    known = MapSet.new(paths, &name/1)
    sections = for([section, _ | _] <- paths, do: name([section]) <> "_") |> Enum.uniq()

    for {variable, _text} <- Enum.sort(env),
        String.starts_with?(variable <> "_", sections),
        not MapSet.member?(known, variable) do
      hint = Schema.did_you_mean(variable, Enum.to_list(known))

      "environment variable #{variable} does not match a key of the configuration and has no effect#{if hint, do: "; " <> hint}"
    end
  end
end
