defmodule Aerie.Fleet.Operations do
  @moduledoc """
  One command, or one change of the desired state, for many vehicles: in steps, with what became of each, and a stop.

      {:ok, operation} =
        Aerie.Fleet.Operations.begin(gateway, %{"tag" => "survey", "command" => %{"type" => "rtl"}, "step" => 5}, source)

  `docs/fleet.md` describes it for users, `Aerie.Fleet.Operations.Request` the keys. Vehicles of other gateways are among them. Answers are maps
  as JSON has them.
  """

  alias Aerie.Vehicle.Command.Error
  alias Aerie.Base.Json
  alias Aerie.Base.Names
  alias Aerie.Fleet.Shadow
  alias Aerie.Fleet.Operations.{Core, Request, Server}
  alias Aerie.Control.Policy.Roles

  @inside Aerie.Control.Policy.Roles.principal(:gateway, "elixir", :admin)

  @type refusal ::
          {:malformed, [Error.t(), ...]}
          | {:role | :busy | :conflict | :unknown | :unavailable, String.t()}

  @doc "Begins an operation in the name of `source`; the same one again gives how it stands."
  @spec begin(Names.gateway(), term(), Roles.source(), via :: String.t()) ::
          {:ok, map()} | {:error, refusal()}
  def begin(gateway, object, source \\ @inside, via \\ "elixir") do
    with :ok <- permitted(source),
         {:ok, request} <- parsed(Request.parse(object, System.os_time(:microsecond))),
         {:ok, vehicles} <- vehicles(gateway, request.targets),
         {:ok, entry} <- Server.begin(gateway, request, vehicles, source, via),
         do: {:ok, plain(entry)}
  end

  @doc "Nothing of it begins any more; what is under way comes to its end."
  @spec stop(Names.gateway(), String.t(), Roles.source()) :: {:ok, map()} | {:error, refusal()}
  def stop(gateway, id, source \\ @inside) do
    with :ok <- permitted(source), {:ok, entry} <- Server.stop(gateway, id), do: {:ok, plain(entry)}
  end

  @doc "An operation with what became of each vehicle."
  @spec get(Names.gateway(), String.t()) :: {:ok, map()} | {:error, refusal()}
  def get(gateway, id) do
    case Server.entry(gateway, id) do
      nil -> {:error, {:unknown, "there is no operation #{id}"}}
      entry -> {:ok, plain(entry)}
    end
  end

  @doc "All operations that are known, the latest first, without their vehicles."
  @spec list(Names.gateway()) :: [map()]
  def list(gateway), do: for(entry <- Server.entries(gateway), do: Map.delete(plain(entry), "vehicles"))

  @doc "A refusal in words."
  @spec text(refusal()) :: String.t()
  def text({:malformed, errors}), do: Enum.join(errors, "; ")
  def text({_kind, text}), do: text

  defp permitted(%{role: :viewer}), do: {:error, {:role, "a viewer changes nothing"}}
  defp permitted(_source), do: :ok

  defp parsed({:ok, request}), do: {:ok, request}
  defp parsed({:error, errors}), do: {:error, {:malformed, errors}}

  defp vehicles(_gateway, {:vehicles, ids}), do: {:ok, ids}

  defp vehicles(gateway, {:tag, tag}) do
    found = for {id, tags} <- Shadow.tags(gateway), tag in tags, do: id

    cond do
      found == [] ->
        {:error, {:malformed, [Error.new("tag", "one that a vehicle has", tag)]}}

      length(found) > Request.max_vehicles() ->
        {:error, {:malformed, [Error.new("tag", "one of at most #{Request.max_vehicles()} vehicles", tag)]}}

      true ->
        {:ok, Enum.sort(found)}
    end
  end

  defp plain(%{core: core, request: request} = entry) do
    waiting = for id <- core.waiting, do: {id, %{"state" => "waiting"}}
    under_way = for id <- core.under_way, do: {id, %{"state" => "under_way"}}

    done =
      for {id, result} <- core.results,
          do:
            {id,
             %{
               "state" => Atom.to_string(result.verdict),
               "result" => result.status,
               "reason" => result.reason
             }}

    %{
      "id" => entry.id,
      "state" => Atom.to_string(core.state),
      "source" => entry.source.name,
      "begun_at" => Json.time(entry.at),
      "done_at" => Json.time(entry.done_at),
      "what" => what(request.what),
      "step" => core.step,
      "counts" => %{
        "waiting" => length(waiting),
        "under_way" => length(under_way),
        "ok" => map_size(core.results) - Core.failed(core),
        "failed" => Core.failed(core)
      },
      "vehicles" => Map.new(waiting ++ under_way ++ done)
    }
  end

  defp what({:command, type, params}), do: %{"command" => %{"type" => type, "params" => params}}
  defp what({:shadow, update}), do: %{"shadow" => update}
end
