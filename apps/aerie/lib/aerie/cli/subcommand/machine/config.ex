defmodule Aerie.CLI.Subcommand.Machine.Config do
  @moduledoc "`aerie config check` and `aerie config show`."
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.Base.Net.PortOwner
  alias Aerie.Config
  alias Aerie.Control.Policy
  alias Aerie.Config.{Keys, Preflight}
  alias Aerie.Base.Settings.Schema
  alias Aerie.CLI.Output.Columns

  @impl Aerie.CLI.Subcommand
  def run(%{name: "config check"} = request) do
    with {:ok, config} <- load(request), {:ok, warnings} <- Preflight.check(config, ours(config)) do
      lines = for warning <- config.warnings ++ warnings, do: "warning: #{warning}\n"
      fence = for line <- fence(config), do: "fence: #{line}\n"

      {0,
       [lines, fence, "#{config.file || "the defaults and the environment"}: a gateway can start with it\n"]}
    else
      {:error, errors} -> {1, for(error <- errors, do: ["error: ", Config.Error.format(error), ?\n])}
    end
  end

  def run(%{name: "config show"} = request) do
    case load(request) do
      {:ok, config} -> {0, Columns.render(~w(KEY VALUE FROM), rows(config, request.options[:all]))}
      {:error, errors} -> {1, for(error <- errors, do: ["error: ", Config.Error.format(error), ?\n])}
    end
  end

  @doc "The configuration of a request, with every error."
  @spec load(Aerie.CLI.Subcommand.request()) :: {:ok, Config.t()} | {:error, [Config.Error.t()]}
  def load(request) do
    {:ok, _started} = Application.ensure_all_started(:fast_yaml)
    Config.load(file(request))
  end

  # Its file: an argument, an option, or AERIE_CONFIG.
  defp file(%{arguments: arguments, options: options, folder: folder}) do
    case arguments["FILE"] || options[:config] || System.get_env("AERIE_CONFIG", "") do
      "" -> nil
      file -> Path.expand(file, folder)
    end
  end

  # Edit, check, reload: the gateway that runs with this file has its ports already.
  defp ours(config) do
    running =
      with {:ok, entries} <- Aerie.Node.list(Path.expand(config.shell.dir)),
           do: for(%{config: file, pid: pid} <- entries, file != nil and file == config.file, do: pid),
           else: (_unreadable -> [])

    fn protocol, port -> Enum.any?(running, &PortOwner.holds_port?(protocol, port, &1)) end
  end

  # Where it is, nobody but a person can check.
  defp fence(config) do
    case Policy.compile(config.policy) do
      {:ok, %{fence: %Policy.Fence{} = fence}} -> Policy.Fence.lines(fence)
      _none -> []
    end
  end

  defp rows(config, all?) do
    for {path, _field} <- Schema.leaves(Keys.fields()),
        key = Config.Error.path(path),
        from <- [config.given[key]],
        all? || from != nil do
      [key, format(key, at(config, path)), from || "default"]
    end
  end

  defp at(config, path) do
    Enum.reduce(path, config, fn name, section ->
      # The names are the schema's own, so their atoms exist.
      if is_map(section), do: Map.get(section, String.to_existing_atom(name))
    end)
  end

  # Secrets are hidden (Aerie.Base.Secret hides itself in inspect); keys that name files are shown.
  defp format(_key, nil), do: nil
  defp format(_key, value) when is_binary(value), do: value
  defp format(_key, value), do: inspect(value, limit: 30, printable_limit: 200)
end
