defmodule Aerie.Api.Rest.Operations.Commands.Give do
  @moduledoc """
  A command in the name of a key, or of its signer (`Aerie.Control.Policy.Roles.Signature`): a signature replaces the
  key. `Aerie.Vehicle.Command` reads the envelope.
  """
  use Aerie.Control.Operations.Operation

  alias Aerie.Access.HTTP.Error
  alias Aerie.Control.{Commands, Policy}
  alias Aerie.Fleet.Bridge

  @impl true
  def operation do
    summary = "Gives a command, and waits for its result."

    %Operation{
      name: "command",
      meaning: summary,
      changes?: true,
      transfer?: false,
      # `Aerie.Fleet.schemas/0` describes it.
      request: ref("command"),
      answer: :result,
      routes: [post("/api/vehicles/:id/commands", summary, change: :command)]
    }
  end

  @impl true
  def run(%{object: object, wait: wait}, %{gateway: gateway, vehicle: vehicle, via: via} = context) do
    envelope = Map.put(object, "vehicle", vehicle)

    with :ok <- same(object, vehicle),
         {:ok, source} <- who(envelope, context),
         do: Commands.submit(gateway, envelope, source, via: via, wait_ms: wait * 1000)
  end

  defp same(%{"vehicle" => other}, vehicle) when other != vehicle,
    do: {:error, {:invalid, "vehicle: the path names another one than the body"}}

  defp same(_object, _vehicle), do: :ok

  # The signer of a command is its source, whichever key the request has.
  defp who(_envelope, %{signed: %{header: nil}, source: source}), do: {:ok, source}

  defp who(envelope, %{gateway: gateway, via: via, signed: %{header: header, body: body}}) do
    subject = "fleet.#{Bridge.environment(gateway)}.#{envelope["vehicle"]}.cmd.#{envelope["type"]}"

    with {:deny, _signature_or_policy, reason} <-
           Policy.signer(gateway, header, subject, body, envelope["id"]) do
      Commands.turned_away(gateway, envelope, nil, via, {:deny, :signature, reason})
      {:error, %{Error.new(:forbidden, reason) | details: %{"result" => "denied", "rule" => "signature"}}}
    end
  end
end
