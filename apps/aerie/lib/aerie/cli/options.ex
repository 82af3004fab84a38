defmodule Aerie.CLI.Options do
  @moduledoc """
  Parses and checks the command line of `bin/run`. Pure: from words to a struct or an error.
  """

  defstruct links: [],
            replay: nil,
            speed: 1.0,
            print: [],
            sim: nil,
            config: nil,
            http: nil,
            nats: nil,
            check_policy: nil,
            command: nil,
            vehicle: nil,
            role: :operator,
            permissions: [],
            check_audit: nil,
            quiet: false

  alias Aerie.Vehicle.Command.Type
  alias Aerie.Control.Policy.Roles

  @typedoc """
  * `links` - connection strings, in the order given
  * `replay` - path of a tlog file to play, or nil
  * `speed` - of a replay or of simulated vehicles, as a multiple of real time; `:max` for a replay
  * `print` - what to print of the recording instead of playing it: `:events`, `:samples`
  * `sim` - number of simulated vehicles, or nil if the command line does not say
  * `config` - path of a YAML configuration, or nil
  * `http` - port of the HTTP server, or nil for the configured one
  * `nats` - "embedded" or a URL, or nil for the configured server
  * `check_policy`, `command`, `vehicle`, `role`, `permissions` - a command to be judged by a configuration's policy
    (`Aerie.CLI.CheckPolicy`); `check_audit` - the folder of an audit log to be checked
  * `quiet` - log lines instead of the table
  """
  @type t :: %__MODULE__{
          links: [String.t()],
          replay: String.t() | nil,
          speed: float() | :max,
          print: [:events | :samples],
          sim: non_neg_integer() | nil,
          config: String.t() | nil,
          http: :inet.port_number() | nil,
          nats: String.t() | nil,
          check_policy: String.t() | nil,
          command: String.t() | nil,
          vehicle: String.t() | nil,
          role: Roles.role(),
          permissions: [Type.permission()],
          check_audit: String.t() | nil,
          quiet: boolean()
        }

  @max_sim 200

  @switches [
    link: :keep,
    replay: :string,
    speed: :string,
    events: :boolean,
    samples: :boolean,
    sim: :integer,
    config: :string,
    http: :integer,
    nats: :string,
    check_policy: :string,
    command: :string,
    vehicle: :string,
    role: :string,
    permission: :keep,
    check_audit: :string,
    quiet: :boolean,
    help: :boolean,
    version: :boolean
  ]

  @help """
  usage: bin/run [OPTION ...]

    Starts the gateway with an embedded NATS server. Without --link, --replay and --config, three simulated vehicles
    fly (in a checkout; a release has none), and UDP port 14550 is open for real ones. Press Ctrl-C to stop it.

    --link STRING      connect to vehicles (may be repeated):
                         #{Enum.join(MavRouter.Link.Transport.help(), "\n" <> String.duplicate(" ", 23))}
    --replay FILE      play a recorded flight (a .tlog file) instead of connecting to vehicles
    --speed N|max      with --replay: playback speed, up to 1000 times real time (default 1)
                       with --sim: the vehicles' time, 0.1 to 100 times real time
    --events           with --replay: print the events of the flight as JSON lines and exit
    --samples          with --replay: print the state samples and exit; with --events, print both
    --sim N            number of simulated vehicles (0 to #{@max_sim}); also together with links
    --config FILE      configuration file; config/gateway.example.yaml documents every key
    --http PORT        port of the HTTP server: /api, /metrics, /healthz, /readyz (0 takes a free one)
    --nats WHERE       embedded (the default) or a URL such as nats://hub:4222
    --quiet            log lines instead of the status table (the default if the output is not a terminal)
    --check-policy FILE --command JSON
                       print what the policy of a configuration decides about a command, and exit: status 0 allowed,
                       1 denied, 2 error. JSON may be the name of a file.
    --vehicle JSON     with --check-policy: what is known about the vehicle, e.g. {"mode": {"armed": false}}
    --role ROLE        with --check-policy: viewer, operator (the default) or admin
    --permission NAME  with --check-policy: a permission beyond the role's, e.g. force_disarm (may be repeated)
    --check-audit DIR  check an audit log, and exit: status 0 intact, 1 damaged or changed, 2 error
    --version          print the version
    --help             print this text
  """

  @doc "The text of `--help`."
  @spec help() :: String.t()
  def help, do: @help

  @doc """
  Parses the words of the command line.

  Returns `{:ok, options}`, `:help`, `:version`, or `{:error, message}`, which says what is wrong and what is expected.
  """
  @spec parse([String.t()]) :: {:ok, t()} | :help | :version | {:error, String.t()}
  def parse(words) do
    case OptionParser.parse(words, strict: @switches, aliases: [h: :help, q: :quiet]) do
      {switches, [], []} -> build(switches)
      {_switches, [word | _rest], []} -> {:error, "unexpected '#{word}': every option starts with --"}
      {_switches, _rest, [{name, value} | _more]} -> {:error, invalid(name, value)}
    end
  end

  defp build(switches) do
    cond do
      switches[:help] -> :help
      switches[:version] -> :version
      true -> validate(switches)
    end
  end

  defp validate(switches) do
    options = %__MODULE__{
      links: Keyword.get_values(switches, :link),
      replay: switches[:replay],
      print: for(what <- [:events, :samples], switches[what], do: what),
      sim: switches[:sim],
      config: switches[:config],
      http: switches[:http],
      nats: switches[:nats],
      check_policy: switches[:check_policy],
      command: switches[:command],
      vehicle: switches[:vehicle],
      check_audit: switches[:check_audit],
      quiet: switches[:quiet] || false
    }

    with {:ok, speed} <- speed(switches[:speed]),
         :ok <- range("--sim", options.sim, 0, @max_sim),
         :ok <- range("--http", options.http, 0, 65_535),
         :ok <- replay_alone(options, switches),
         :ok <- print_alone(options, switches),
         :ok <- nats(options.nats),
         :ok <- check_alone(switches),
         {:ok, role} <- one_of("--role", switches[:role] || "operator", Roles.all()),
         {:ok, permissions} <- permissions(Keyword.get_values(switches, :permission)) do
      {:ok, %{options | speed: speed, role: role, permissions: permissions}}
    end
  end

  defp speed(nil), do: {:ok, 1.0}
  defp speed("max"), do: {:ok, :max}

  defp speed(text) do
    case Float.parse(text) do
      {speed, ""} when speed > 0 and speed <= 1000 -> {:ok, speed}
      _other -> {:error, "--speed: expected a number above 0 and up to 1000, or max, got: #{text}"}
    end
  end

  defp range(_name, nil, _low, _high), do: :ok
  defp range(_name, value, low, high) when value >= low and value <= high, do: :ok
  defp range(name, value, low, high), do: {:error, "#{name}: expected #{low} to #{high}, got: #{value}"}

  defp replay_alone(%{replay: nil}, switches) do
    case switches[:speed] && {switches[:sim], speed(switches[:speed])} do
      nil -> :ok
      {nil, _speed} -> {:error, "--speed needs --replay FILE or --sim N"}
      {_sim, {:ok, speed}} when is_float(speed) and speed >= 0.1 and speed <= 100 -> :ok
      _other -> {:error, "--speed: expected 0.1 to 100 with --sim, got: #{switches[:speed]}"}
    end
  end

  defp replay_alone(%{links: [_ | _]}, _switches),
    do: {:error, "--replay and --link exclude each other: a recording must not mix with live vehicles"}

  defp replay_alone(_options, _switches), do: :ok

  defp print_alone(%{print: []}, _switches), do: :ok

  defp print_alone(%{replay: nil, print: [what | _]}, _switches),
    do: {:error, "--#{what} needs --replay FILE"}

  defp print_alone(%{print: [what | _]}, switches) do
    case Enum.find([:speed, :sim, :http, :nats, :quiet], &(switches[&1] != nil)) do
      nil -> :ok
      other -> {:error, "--#{what} only prints and starts no gateway: leave out --#{other}"}
    end
  end

  @with_check [:check_policy, :command, :vehicle, :role, :permission]

  defp check_alone(switches) do
    given = switches |> Keyword.keys() |> Enum.uniq()

    cond do
      :check_policy in given and :command not in given -> {:error, "--check-policy needs --command JSON"}
      :check_policy in given -> alone("--check-policy", given -- @with_check)
      :check_audit in given -> alone("--check-audit", given -- [:check_audit])
      other = Enum.find(given, &(&1 in @with_check)) -> {:error, "--#{other} needs --check-policy FILE"}
      true -> :ok
    end
  end

  defp alone(_name, []), do: :ok

  defp alone(name, [other | _rest]),
    do: {:error, "#{name} starts no gateway: leave out --#{String.replace("#{other}", "_", "-")}"}

  defp permissions(names) do
    Enum.reduce_while(names, {:ok, []}, fn name, {:ok, known} ->
      case one_of("--permission", name, Type.permissions()) do
        {:ok, permission} -> {:cont, {:ok, [permission | known]}}
        error -> {:halt, error}
      end
    end)
  end

  defp one_of(option, text, known) do
    case Enum.find(known, &(Atom.to_string(&1) == text)) do
      nil -> {:error, "#{option}: expected #{Enum.join(known, ", ")}, got: #{text}"}
      found -> {:ok, found}
    end
  end

  defp nats(nil), do: :ok
  defp nats("embedded"), do: :ok

  defp nats(url) do
    case URI.parse(url) do
      %URI{scheme: scheme, host: host} when scheme in ["nats", "tls"] and is_binary(host) and host != "" ->
        :ok

      _other ->
        {:error, "--nats: expected embedded or a URL such as nats://127.0.0.1:4222, got: #{url}"}
    end
  end

  defp invalid(name, nil) do
    case closest(name) do
      nil -> "unknown option #{name}, or its value is missing; bin/run --help lists the options"
      ^name -> "#{name} needs a value; see bin/run --help"
      other -> "unknown option #{name}; did you mean #{other}?"
    end
  end

  defp invalid(name, value), do: "#{name}: '#{value}' is not a whole number"

  defp closest(name) do
    names = for {switch, _type} <- @switches, do: "--" <> String.replace("#{switch}", "_", "-")
    best = Enum.max_by(names, &String.jaro_distance(&1, name))
    if String.jaro_distance(best, name) > 0.8, do: best
  end
end
