defmodule Aerie.CLI.FacesTest do
  use ExUnit.Case, async: true

  alias Aerie.Link.Spec
  alias Aerie.CLI.Status.Access

  defp link(text, more \\ []) do
    spec = Spec.parse!(text, id: "x", options: Keyword.get(more, :options, %{}))
    %{id: "x", kind: spec.kind, url: spec.text, spec: spec, local: more[:local], peer: more[:peer]}
  end

  defp who(link, gcs), do: [link] |> Access.list(%{"x" => gcs}, [], nil) |> hd() |> Map.take([:who, :wide])

  test "a link says who may command by it" do
    wide = link("udpin:0.0.0.0:14550", local: "0.0.0.0:14550")

    assert who(wide, :auto) == %{
             who: "anyone who reaches it: vehicles; commands from this machine only",
             wide: false
           }

    assert who(wide, :deny) == %{who: "anyone who reaches it: vehicles; no commands", wide: false}

    assert %{who: "anyone who reaches it: vehicles, and commands to vehicles" <> _, wide: true} =
             who(wide, :allow)

    own = link("udpin:127.0.0.1:14650", local: "127.0.0.1:14650")

    assert who(own, :auto) == %{
             who: "programs of this machine: vehicles, and commands to vehicles",
             wide: false
           }

    assert who(link("/dev/ttyUSB0"), :auto) == %{
             who: "the other end: vehicles; no commands",
             wide: false
           }

    assert who(link("tcp:10.0.0.7:5760", peer: "10.0.0.7:5760"), :auto).who =~ "no commands"
    assert who(link("replay:flight.tlog"), :allow).who =~ "no commands"
  end

  test "clients and servers say who may use them" do
    client = fn text, local, router -> link(text, local: local, options: %{router: router}) end
    own = client.("tcpin:127.0.0.1:0", "127.0.0.1:5790", [])
    wide = client.("tcpin:0.0.0.0:5790", "0.0.0.0:5790", [])
    looks = client.("tcpin:0.0.0.0:5791", "0.0.0.0:5791", role: :read_only)
    config = Aerie.Config.default(%{})

    assert [
             %{
               address: "tcpin:127.0.0.1:5790 (x)",
               who: "programs of this machine: look on and command vehicles",
               wide: false
             },
             %{who: "anyone who reaches it: look on and command vehicles", wide: true},
             %{who: "anyone who reaches it: look on", wide: false},
             %{address: "http://127.0.0.1:4000", who: "programs of this machine: " <> _, wide: false},
             %{address: "http://127.0.0.1:4000 console", who: "users who sign in: " <> _, wide: false},
             %{address: "ws://127.0.0.1:8765", wide: false},
             %{address: "mavlink.sock"},
             %{address: "nats (embedded)", who: "anyone with its login: " <> _}
           ] = Access.list([], %{}, [own, wide, looks], config)

    keyed = put_in(config.api.key, "a-long-random-text")
    assert Enum.any?(Access.list([], %{}, [], keyed), &(&1.who =~ "anyone with a key"))
  end
end
