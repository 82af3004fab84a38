defmodule Aerie.CLI.FacesTest do
  use ExUnit.Case, async: true

  alias MavRouter.Link.Spec
  alias Aerie.CLI.Status.Access

  defp link(text, more \\ []) do
    spec = Spec.parse!(text, id: "x", options: Keyword.get(more, :options, %{}))
    %{id: "x", kind: spec.kind, url: spec.text, spec: spec, local: more[:local], peer: more[:peer]}
  end

  defp who(link, gcs), do: [link] |> Access.list(%{"x" => gcs}, [], nil) |> hd() |> Map.take([:who, :wide])

  test "a link says who may command by it" do
    wide = link("udpin:0.0.0.0:14550", local: "0.0.0.0:14550")

    assert who(wide, :auto) == %{
             who: "anyone who reaches it: vehicles; commands from this machine only (operator)",
             wide: false
           }

    assert who(wide, :deny) == %{who: "anyone who reaches it: vehicles; no commands", wide: false}

    assert %{who: "anyone who reaches it: vehicles, and commands to vehicles" <> _, wide: true} =
             who(wide, :allow)

    own = link("udpin:127.0.0.1:14650", local: "127.0.0.1:14650")

    assert who(own, :auto) == %{
             who: "programs of this machine: vehicles, and commands to vehicles (operator)",
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

    out = client.("tcp:10.0.0.7:5790", "10.0.0.1:40000", [])
    list = &Access.list([], %{}, [own, wide, looks, out], config, &1)

    assert [
             %{
               address: "tcpin:127.0.0.1:5790 (x)",
               who: "programs of this machine: look on and command vehicles (operator)",
               wide: false
             },
             %{
               who:
                 "anyone who reaches it: look on (viewer); programs of this machine: look on and command vehicles (operator)",
               wide: false
             },
             %{who: "anyone who reaches it: look on (read_only)", wide: false},
             %{who: "the other end: look on (viewer)", wide: false},
             %{
               address: "http://127.0.0.1:4000",
               who: "programs of this machine: look on, and save recordings; no commands" <> _
             },
             %{address: "http://127.0.0.1:4000 console", who: "users who sign in: " <> _, wide: false},
             %{
               address: "ws://127.0.0.1:8765",
               who: "programs of this machine: look on and command vehicles (operator)"
             },
             %{address: "mavlink.sock", who: "users whom its file permissions admit: " <> _},
             %{
               address: "nats (embedded)",
               who: "anyone with its login: read, and change what is stored; commands with a signature" <> _
             }
           ] = list.([])

    # An entry by the id, and one for all others; what no role has is said by name.
    ids =
      list.([
        %{id: "x", role: :admin, permissions: [:force_disarm]},
        %{id: nil, role: :viewer, permissions: []}
      ])

    assert Enum.at(ids, 0).who ==
             "programs of this machine: look on, command and maintain vehicles (admin, force_disarm)"

    assert %{who: "anyone who reaches it: look on, command and maintain" <> _, wide: true} = Enum.at(ids, 1)

    assert Enum.find(ids, &(&1.address == "ws://127.0.0.1:8765")).who ==
             "programs of this machine: look on (viewer)"

    others = list.([%{id: nil, role: :viewer, permissions: []}])
    assert Enum.at(others, 0).who == "programs of this machine: look on (viewer)"
    assert %{who: "anyone who reaches it: look on (viewer)", wide: false} = Enum.at(others, 1)

    link = link("udpin:0.0.0.0:14550", local: "0.0.0.0:14550")
    viewer = [%{id: nil, role: :viewer, permissions: []}]

    assert %{who: "anyone who reaches it: vehicles; no commands"} =
             hd(Access.list([link], %{"x" => :allow}, [], nil, viewer))

    unsigned = put_in(config.policy.unsigned, :operator)
    assert %{who: words, wide: true} = [] |> Access.list(%{}, [], unsigned) |> List.last()
    assert words =~ "commands without a signature as operator"

    keyed = put_in(config.api.key, "a-long-random-text")
    assert Enum.any?(Access.list([], %{}, [], keyed), &(&1.who =~ "anyone with a key"))
  end
end
