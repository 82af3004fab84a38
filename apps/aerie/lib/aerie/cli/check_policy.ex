defmodule Aerie.CLI.CheckPolicy do
  @moduledoc """
  `bin/run --check-policy FILE --command JSON`: prints what the policy of a configuration decides about a command, without starting a gateway.

  `--vehicle` describes the vehicle as far as it is known, with the groups of `GET /api/vehicles/ID`
  (`Aerie.Control.Policy.Context.parse/3`); `--role` is that of the source, operator if left out. Rates are not checked: they depend on what
  was commanded before.
  """

  alias Aerie.Config
  alias Aerie.Control.Policy
  alias Aerie.Vehicle.Command
  alias Aerie.CLI.Options
  alias Aerie.Control.Policy.{Context, Roles}

  @doc "`{:finish, text}` for an allowed command, `{:denied, text}` with rule and reason, `{:fail, text}` for what cannot be judged."
  @spec run(Options.t(), folder :: String.t()) :: {:finish | :denied | :fail, String.t()}
  def run(%Options{} = options, folder) do
    now = System.os_time(:microsecond)

    with {:ok, policy} <- policy(Path.expand(options.check_policy, folder)),
         {:ok, command} <- command(options.command, folder, now),
         {:ok, vehicle} <- json("--vehicle", options.vehicle || "{}", folder),
         source = Roles.principal(:user, command.source, options.role, options.permissions),
         {:ok, context} <- context(vehicle, source, now) do
      case Policy.decide(policy, command, context) do
        :allow -> {:finish, "allow\n"}
        {:deny, rule, reason} -> {:denied, "deny #{rule}: #{reason}\n"}
      end
    else
      {:error, lines} -> {:fail, Enum.map_join(List.wrap(lines), &"error: #{&1}\n")}
    end
  end

  # As a start reads it, the environment included.
  defp policy(file) do
    case Config.load(file) do
      {:ok, config} -> Policy.compile(config.policy)
      {:error, errors} -> {:error, String.split(Config.format_errors(errors), "\n", trim: true)}
    end
  end

  defp command(text, folder, now) do
    with {:ok, %{} = given} <- json("--command", text, folder),
         {:ok, command} <-
           %{"id" => "check", "vehicle" => "any", "source" => "you"} |> Map.merge(given) |> Command.parse(now) do
      {:ok, command}
    else
      {:ok, _other} ->
        {:error, ~s(--command: expected an object such as {"type": "arm"})}

      {:error, [%Command.Error{} | _] = errors} ->
        {:error, Enum.map(errors, &"--command: #{Exception.message(&1)}")}

      {:error, text} ->
        {:error, text}
    end
  end

  defp context(vehicle, source, now) do
    with {:error, errors} <- Context.parse(vehicle, source, now),
         do: {:error, Enum.map(errors, &"--vehicle: #{&1}")}
  end

  # JSON, or the name of a file with it.
  defp json(option, text, folder) do
    with {:ok, text} <- text(String.trim_leading(text), folder),
         {:ok, value} <- JSON.decode(text) do
      {:ok, value}
    else
      {:error, posix} when is_atom(posix) -> {:error, "#{option}: #{text}: #{:file.format_error(posix)}"}
      {:error, _json} -> {:error, "#{option}: expected JSON, got something else"}
    end
  end

  defp text("{" <> _ = json, _folder), do: {:ok, json}
  defp text("[" <> _ = json, _folder), do: {:ok, json}
  defp text(file, folder), do: file |> Path.expand(folder) |> File.read()
end
