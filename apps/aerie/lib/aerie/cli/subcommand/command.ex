defmodule Aerie.CLI.Subcommand.Command do
  @moduledoc "`aerie cmd`: one command, one result (`Aerie.Control.Commands`)."
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.Vehicle.Command.{Result, Types}
  alias Aerie.Control.Commands
  alias Aerie.Fleet
  alias Aerie.Base.Json
  alias Aerie.CLI.{Ask, Subcommand}
  alias Aerie.CLI.Output.Columns

  @impl Aerie.CLI.Subcommand
  def run(%{arguments: %{"VEHICLE" => vehicle, "TYPE" => type, "NAME=VALUE" => pairs}, options: options}) do
    with {:ok, params} <- params(pairs), do: give(vehicle, type, params, options)
  end

  @doc "Submits a command as `source/0`. Commands that move a vehicle ask for confirmation first."
  @spec give(String.t(), String.t(), map(), map()) :: {0..1, iodata()} | {:error, String.t()}
  def give(vehicle, type, params, options) do
    with {:known, %{}} <- {:known, Fleet.vehicle(:default, vehicle)},
         {:type, {:ok, row}} <- {:type, Types.fetch(type)},
         :ok <- if(row.moves_vehicle?, do: Ask.first(command_text(vehicle, type, params), options), else: :ok) do
      envelope = %{"vehicle" => vehicle, "type" => type, "params" => params}
      answer(Commands.submit(:default, envelope, source(), via: "bin/aerie"), options)
    else
      {:known, nil} -> {:error, Subcommand.Running.Tail.unknown(vehicle)}
      {:type, :error} -> {:error, "there is no command #{type}#{hint(type)}; docs/commands.md lists them"}
      {:error, text} -> {:error, text}
    end
  end

  defp command_text(vehicle, type, params),
    do:
      Enum.join(
        [type | for({name, value} <- params, do: "#{name}=#{Json.encode!(value)}")] ++ ["to", vehicle],
        " "
      )

  @doc "The source of commands from `bin/aerie`, for the policy and the audit log: the gateway's own user."
  @spec source() :: Aerie.Control.Policy.Roles.source()
  def source, do: %{Commands.inside() | name: "bin/aerie"}

  @doc "Parameters from words such as `altitude=20`. Values are JSON where they can be, else text. Pure."
  @spec params([String.t()]) :: {:ok, %{String.t() => term()}} | {:error, String.t()}
  def params(pairs) do
    Enum.reduce_while(pairs, {:ok, %{}}, fn pair, {:ok, params} ->
      case String.split(pair, "=", parts: 2) do
        [name, value] when name != "" -> {:cont, {:ok, Map.put(params, name, value(value))}}
        _other -> {:halt, {:error, "'#{pair}': expected NAME=VALUE"}}
      end
    end)
  end

  defp value(text) do
    case JSON.decode(text) do
      {:ok, value} -> value
      {:error, _no_json} -> text
    end
  end

  @doc "An answer as text, with its exit status."
  @spec answer(Commands.answer() | {:error, Result.t()}, map()) :: {0..1, iodata()} | {:error, String.t()}
  def answer({:ok, %Result{} = result}, options) do
    text = if options[:json], do: Json.encode!(Result.plain(result)), else: command_text(result)
    {if(result.status in [:completed, :accepted], do: 0, else: 1), [text, ?\n]}
  end

  def answer({:error, %Result{} = result}, options), do: answer({:ok, result}, options)
  def answer({:pending, id}, _options), do: {1, "command #{id} is under way\n"}
  def answer({:error, errors}, _options), do: {:error, Enum.join(errors, "; ")}

  defp command_text(%{reason: reason, status: status, details: details}) do
    removed = if details["removed"], do: "removed: #{details["removed"]}"
    said = for text <- [reason, removed | details["remarks"] || []], text != nil, do: Columns.cell(text)
    Enum.join([status | said], ": ")
  end

  defp hint(type) do
    best = Enum.max_by(Types.names(), &String.jaro_distance(&1, type))
    if String.jaro_distance(best, type) > 0.75, do: "; did you mean #{best}?", else: ""
  end
end
