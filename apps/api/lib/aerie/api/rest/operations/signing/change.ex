defmodule Aerie.Api.Rest.Operations.Signing.Change do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Fleet
  alias Aerie.Vehicle.Enrolment

  @results [enrol: "enrolled", revoke: "revoked", discard: "discarded"]

  # A request cannot contain a key or name a file of this machine (S9).
  @impl true
  def operation do
    summary = "Gives a vehicle a signing key, or takes it away."

    %Operation{
      name: "signing.change",
      meaning: "Changes the signing key of a vehicle.",
      transfer?: false,
      closed?: true,
      fields: [
        field(:action, {:enum, Keyword.keys(@results)}, "discard: forget the key without the vehicle",
          required: true
        ),
        field(:key, {:enum, [:configured, :generate, :previous]}, "which key; of enrol only",
          default: :configured
        ),
        field(:link, {:bytes, 512}, "the link that carries the key"),
        field(:component, {:integer, 1, 255}, "the component that gets it")
      ],
      rules: [
        anyOf: [
          %{properties: %{action: %{const: :enrol}}},
          %{properties: %{key: %{enum: [:configured, nil]}}}
        ]
      ],
      answer: %{result: %{enum: Keyword.values(@results)}},
      routes: [post("/api/vehicles/:id/signing", summary, change: :sign_vehicle)]
    }
  end

  # Waits until the vehicle uses the key, for ten seconds at most. The answer never contains a new key, which stays in
  # the gateway's folder of keys.
  @impl true
  def run(%{action: action, key: key}, _context) when action != :enrol and key != :configured,
    do: {:error, {:invalid, "key: only the action enrol has one"}}

  def run(input, %{gateway: gateway, vehicle: id, by: by}) do
    known = for name <- [:link, :component], value = input[name], do: {name, value}
    options = [by: by] ++ if(input.key == :configured, do: known, else: [key: input.key] ++ known)

    with %{} <-
           Fleet.vehicle(gateway, id) || {:error, {:unknown, "no vehicle has this name; see /api/vehicles"}},
         {:ok, answer} <- sign(input.action, gateway, id, options),
         do: {:ok, Map.put(answer, :result, @results[input.action])}
  end

  defp sign(:enrol, gateway, id, options), do: linked(Enrolment.enrol(gateway, id, options))
  defp sign(:revoke, gateway, id, options), do: linked(Enrolment.revoke(gateway, id, options))
  defp sign(:discard, gateway, id, _options), do: linked(Enrolment.discard(gateway, id))

  defp linked({:ok, %{link: link}}), do: {:ok, %{link: link}}
  defp linked(:ok), do: {:ok, %{}}
  defp linked({:error, error}), do: {:error, error}
end
