defmodule Aerie.Config.Environment do
  @moduledoc """
  Environment variables that override the file: `AERIE_` and the key's path in capitals, joined by `_`.

  `nats.url` is `AERIE_NATS_URL`, `mavlink.system_id` is `AERIE_MAVLINK_SYSTEM_ID`, `sampling.groups.gps.hz` is
  `AERIE_SAMPLING_GROUPS_GPS_HZ`. A list or a map is given as YAML or JSON text; a list of words also with commas.
  """

  alias Aerie.Config.{Error, Keys, Yaml}
  alias Aerie.Base.Settings.Schema

  @doc "The variable of a key, from its path."
  @spec name(Schema.path()) :: String.t()
  def name(path), do: "AERIE_" <> Enum.map_join(path, "_", &String.upcase/1)

  # Read by the script that starts the gateway in the background.
  @scripts ["AERIE_LOG_DIR"]

  @doc "The overrides in `env`: path, text and the variable's name."
  @spec overrides(%{String.t() => String.t()}) :: [
          {Schema.path(), {:text, String.t(), function()}, String.t()}
        ]
  def overrides(env) do
    for {path, _field} <- Schema.leaves(Keys.fields()),
        text = env |> Map.get(name(path), "") |> String.trim(),
        text != "" do
      {path, {:text, text, &Yaml.parse_value/1}, source(name(path))}
    end
  end

  @doc """
  What is wrong with the variables: a key's one that is empty, which would silently mean the default, and one that begins like a
  section (`AERIE_NATS_…`) but matches no key. `named` are those that the configuration names (`signing.keys[].key_env`).
  """
  @spec errors(%{String.t() => String.t()}, named :: [String.t()]) :: [Error.t()]
  def errors(env, named) do
    paths = Enum.map(Schema.leaves(Keys.fields()), &elem(&1, 0))
    known = Map.new(paths, &{name(&1), &1})
    sections = for([section, _ | _] <- paths, do: name([section]) <> "_") |> Enum.uniq()

    empty =
      for {variable, path} <- known, text = env[variable], String.trim(text) == "" do
        hint = "take the variable away for the default"

        %Error{
          file: source(variable),
          path: Error.path(path),
          expected: "a value",
          got: "an empty text",
          hint: hint
        }
      end

    unknown =
      for {variable, _text} <- env,
          String.starts_with?(variable <> "_", sections),
          not is_map_key(known, variable) and variable not in (named ++ @scripts) do
        hint = Schema.did_you_mean(variable, Map.keys(known))

        %Error{
          file: source(variable),
          path: "",
          expected: "a variable of a key",
          got: "an unknown one",
          hint: hint
        }
      end

    Enum.sort_by(empty ++ unknown, & &1.file)
  end

  defp source(variable), do: "environment variable " <> variable
end
