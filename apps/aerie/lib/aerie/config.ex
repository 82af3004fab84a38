defmodule Aerie.Config do
  @moduledoc """
  The configuration of one gateway: read once, checked completely, then passed down as this struct. No module below
  reads the application environment.

  `load/3` merges, in rising precedence: defaults, a YAML file, the environment (`AERIE_…`), overrides (the command line).
  It returns all problems at once, as a list of `Aerie.Config.Error`; nothing is started before that list
  is empty and `Aerie.Config.Preflight.check/1` has found ports, folders and files usable.

  The sections are maps with the keys of `config/gateway.example.yaml` (made from `Aerie.Config.Keys`). Derived values
  are filled in, so that readers need no rules of their own:

    * `nats.mode` is `:embedded`, `:url` or `:off`; `nats.url` is a list of URLs without passwords
    * `mavlink.system_id` is set, a number or `:auto` (`MavRouter.Router.AutoSystemId`)
    * `links` has `id`, `url`, `network`, `label`, `enabled`, `secure` for each, the one of `mavlink.local_addr` included; `spec` is
      the parsed `MavRouter.Link.Spec`, `given` says whether somebody asked for it (a taken port is then an error)
    * `clients` is `:default` if they are not configured, otherwise a list of maps with `id`, `url`, `networks` and
      their rules (`MavRouter.Endpoints.Owner.RuleKeys`)
    * `vehicles` has `id`, `network`, `system_id` for each, the one of `vehicle_id` included
    * `sampling.groups` has `position_hz`, `attitude_hz` and `battery_change_threshold` worked in
    * `warnings` are settings that are allowed but probably not intended; `given` has the keys that were set, and where;
      `lines` has the lines of the file's keys
  """

  alias Aerie.Config.{Environment, Error, Keys, Resolve, Yaml}
  alias Aerie.Base.Settings.{Field, Schema}

  defstruct Keys.order() ++ [file: nil, given: %{}, lines: %{}, warnings: []]

  @type link :: %{
          id: String.t(),
          url: String.t(),
          network: String.t(),
          label: String.t() | nil,
          enabled: boolean(),
          secure: boolean(),
          given: boolean(),
          spec: MavRouter.Link.Spec.t()
        }

  @type vehicle :: %{id: String.t(), network: String.t(), system_id: pos_integer()}

  @type group :: %{
          strategy: :time | :change | :threshold | :aggregate,
          hz: float(),
          threshold: %{String.t() => float()},
          refresh_s: float()
        }

  @type t :: %__MODULE__{
          vehicle_id: String.t() | nil,
          environment: String.t(),
          network: String.t(),
          mavlink: map(),
          links: [link()],
          clients: :default | [map()],
          router: map(),
          vehicles: [vehicle()],
          signing: map(),
          recorder: map(),
          tracks: map(),
          nats: map(),
          outbox: map(),
          sampling: %{:groups => %{atom() => group()}, optional(atom()) => term()},
          events: map(),
          policy: map(),
          http: map(),
          api: map(),
          websocket: map(),
          sockets: map(),
          serial: %{ports: [String.t()], bauds: [pos_integer()]},
          timeouts: map(),
          limits: map(),
          file: String.t() | nil,
          given: %{String.t() => String.t()},
          lines: Yaml.Lines.t(),
          warnings: [String.t()]
        }

  @typedoc """
  `{"nats.url", value}` pairs (a string value is read as the key's type), or nested maps. A map for a section sets the
  given keys and leaves the section's others unchanged; lists and maps of names count as one key and are replaced.
  """
  @type overrides :: [{String.t(), term()}] | %{optional(String.t()) => term()}

  @doc """
  Reads, merges and checks. `path` nil means no file.

  Options: `:env`, the environment as a map (default: the process's own; `%{}` for none).
  """
  @spec load(Path.t() | nil, overrides(), keyword()) :: {:ok, t()} | {:error, [Error.t()]}
  def load(path \\ nil, overrides \\ [], opts \\ []) do
    env = Keyword.get_lazy(opts, :env, &System.get_env/0)

    with {:ok, file, lines} <- read(path) do
      layers = Environment.overrides(env) ++ override_list(overrides)

      with {:ok, config} <- build(file, layers, {path, lines}),
           [] <- Environment.errors(env, for(%{key_env: name} <- config.signing.keys, name, do: name)) do
        {:ok, config}
      else
        {:error, errors} -> {:error, errors ++ Environment.errors(env, [])}
        errors -> {:error, errors}
      end
    end
  end

  @doc """
  The defaults with overrides, without file and environment. Raises `ArgumentError` on an invalid override: for tests and
  for callers that know what they pass.
  """
  @spec default(overrides()) :: t()
  def default(overrides \\ []) do
    case load(nil, overrides, env: %{}) do
      {:ok, config} -> config
      {:error, errors} -> raise ArgumentError, Enum.map_join(errors, "\n", &Error.format/1)
    end
  end

  @doc "Whether somebody set this key (`\"http.port\"`) in the file, the environment or on the command line."
  @spec given?(t(), String.t()) :: boolean()
  def given?(%__MODULE__{given: given}, path), do: is_map_key(given, path)

  @doc "All networks, the gateway's own first."
  @spec networks(t()) :: [String.t(), ...]
  def networks(%__MODULE__{network: own, links: links, vehicles: vehicles}),
    do: Enum.uniq([own | Enum.map(links ++ vehicles, & &1.network)])

  @doc "Errors as lines for a person."
  @spec format_errors([Error.t()]) :: String.t()
  def format_errors(errors), do: Enum.map_join(errors, "\n", &Error.format/1)

  defp read(nil), do: {:ok, %{}, %{}}

  defp read(path) do
    with {:ok, text} <- read_bounded(path), {:ok, map} <- Yaml.parse(text) do
      {:ok, map, Yaml.lines(text)}
    else
      {:error, %{expected: expected} = reason} ->
        {:error, [%Error{file: path, path: "", line: reason.line, expected: expected, got: reason.got}]}

      {:error, posix} ->
        reason = posix |> :file.format_error() |> to_string()
        {:error, [%Error{file: path, path: "", expected: "a readable file", got: reason}]}
    end
  end

  # A device or a log given by mistake must not be read to its end; the reader refuses more than this anyway.
  defp read_bounded(path) do
    with {:ok, text} <- File.open(path, [:read, :binary, :raw], &:file.read(&1, 262_145)) do
      case text do
        {:ok, text} -> {:ok, text}
        :eof -> {:ok, ""}
        {:error, reason} -> {:error, reason}
      end
    end
  end

  defp override_list(overrides) do
    for {path, value} <- overrides,
        path = if(is_list(path), do: path, else: String.split(to_string(path), ".")),
        {path, value} <- leaves(path, Schema.plain(value), at(Keys.fields(), path)) do
      {path, if(is_binary(value), do: {:text, value, &Yaml.parse_value/1}, else: value), "command line"}
    end
  end

  # Only single keys of a section are overridden; otherwise another URL would switch TLS off.
  defp leaves(path, section, %Field{type: {:section, fields}}) when is_map(section) do
    for {key, value} <- section, leaf <- leaves(path ++ [key], value, at(fields, [key])), do: leaf
  end

  defp leaves(path, value, _key_or_unknown), do: [{path, value}]

  defp at(fields, [name | below]) do
    case {Enum.find(fields, &(Field.name(&1) == name)), below} do
      {field, []} -> field
      {%Field{type: {:section, fields}}, below} -> at(fields, below)
      _unknown -> nil
    end
  end

  defp build(file, layers, {path, lines}) do
    file = whole_names(file, Keys.fields(), path)
    raw = Enum.reduce(layers, file, fn {keys, value, _source}, raw -> put(raw, keys, value) end)
    {values, problems} = Schema.validate(Keys.fields(), raw)
    source = &source(&1, layers, path)

    with [] <- problems,
         config = struct!(%__MODULE__{file: path, given: given(raw, source), lines: lines}, values),
         {config, []} <- Resolve.run(config) do
      {:ok, config}
    else
      {_config, problems} -> {:error, Enum.map(problems, &error(&1, source, {path, lines}))}
      problems -> {:error, Enum.map(problems, &error(&1, source, {path, lines}))}
    end
  end

  # A relative name of a file that the gateway only reads (`:file`) begins at the folder of the configuration file, so
  # that a file and its keys and certificates can be copied together. Its own folders (`:path`) begin at `AERIE_HOME`,
  # and so does a name from the environment or the command line. Other values are left for the checks.
  defp whole_names(raw, _fields, nil), do: raw

  defp whole_names(raw, fields, path),
    do: whole_name(raw, {:section, fields}, Path.dirname(Path.expand(path)))

  defp whole_name(name, :file, folder) when is_binary(name) and name != "", do: Path.absname(name, folder)

  defp whole_name(raw, {:section, fields}, folder) when is_map(raw) do
    for %Field{type: type} = field <- fields, is_map_key(raw, Field.name(field)), reduce: raw do
      raw -> Map.update!(raw, Field.name(field), &whole_name(&1, type, folder))
    end
  end

  defp whole_name(raw, {:list, type}, folder) when is_list(raw),
    do: Enum.map(raw, &whole_name(&1, type, folder))

  defp whole_name(raw, _type, _folder), do: raw

  # A caller in Elixir that has no value for it.
  defp put(raw, [key], nil) when is_map(raw), do: Map.delete(raw, key)
  defp put(raw, [key], value) when is_map(raw), do: Map.put(raw, key, value)

  defp put(raw, [key | below], value) when is_map(raw) do
    case Map.get(raw, key) do
      empty when empty in [nil, []] -> Map.put(raw, key, put(%{}, below, value))
      section -> Map.put(raw, key, put(section, below, value))
    end
  end

  # The file has another value in place of a section; the schema check reports it.
  defp put(raw, _keys, _value), do: raw

  defp given(raw, source) do
    for {path, _field} <- Schema.leaves(Keys.fields()), present?(raw, path), into: %{} do
      {Error.path(path), source.(path)}
    end
  end

  defp present?(raw, [key]) when is_map(raw), do: Map.get(raw, key) != nil
  defp present?(raw, [key | below]) when is_map(raw), do: present?(Map.get(raw, key), below)
  defp present?(_raw, _path), do: false

  # The error comes from the last layer that set this key, or one above or below it.
  defp source(path, layers, file) do
    layers
    |> Enum.reverse()
    |> Enum.find_value(file || "defaults", fn {keys, _value, source} ->
      if List.starts_with?(path, keys), do: source
    end)
  end

  defp error(problem, source, {path, lines}) do
    file = source.(problem.path)

    %Error{
      file: file,
      path: Error.path(problem.path),
      line: if(file == path, do: Yaml.Lines.at(lines, problem.path)),
      expected: problem.expected,
      got: problem.got,
      hint: problem.hint
    }
  end
end
