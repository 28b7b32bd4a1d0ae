//! Content anchors: what is sent, and what is refused.

use super::common;

use common::{Service, problem, reply};
use veiloc_client::{AnchorPose, ClientError, ContentAnchor, ContentAnchorError};

#[test]
fn anchors_are_fetched_written_and_deleted() {
    let json =
        |status: &str, body: &str| reply(status, &[("content-type", "application/json")], body.as_bytes());
    let list = r#"{"version":1,"anchors":[{"name":"door","map_from_anchor":{"q":[1,0,0,0],"t":[1,2,3]},"content":[1]}]}"#;
    let service = Service::replying(vec![
        json("200 OK", list),
        problem("503 No", "stopping", &[("retry-after", "0")]),
        json("201 Created", "{}"),
        problem("403 No", "not-owner", &[]),
        reply("204 No Content", &[], b""),
        json("200 OK", "{\"version\":1}"),
        reply("200 OK", &[("content-type", "text/html")], b"<h1>Hotel</h1>"),
    ]);
    let client = service.client();
    let anchors = client.anchors("place").expect("a list");
    let door = &anchors.anchors()[0];
    assert_eq!((door.name.as_str(), door.map_from_anchor.t), ("door", [1.0, 2.0, 3.0]));
    client.put_anchor("place", door).expect("written, at the second attempt");
    let refused = client.put_anchor("place", door);
    assert!(
        matches!(&refused, Err(ClientError::Refused(refusal)) if refusal.name == "not-owner"),
        "{refused:?}"
    );
    client.delete_anchor("place", "door").expect("deleted");
    for _ in 0..2 {
        assert!(matches!(client.anchors("place"), Err(ClientError::BadAnswer { .. })));
    }
    let requests = service.requests();
    assert!(requests[1].head.starts_with("put /v1/maps/place/anchors/door ") && requests[1] == requests[2]);
    assert!(requests[1].head.contains("authorization: bearer the-token"));
    assert!(requests[4].head.starts_with("delete /v1/maps/place/anchors/door "));

    // What no service takes is not sent.
    for name in ["", "a/b", "..", "a\r\nx: y"] {
        assert!(
            matches!(client.delete_anchor("place", name), Err(ClientError::Anchor(ContentAnchorError::Name))),
            "{name:?}"
        );
    }
    let flat = ContentAnchor { map_from_anchor: AnchorPose { q: [0.0; 4], t: [0.0; 3] }, ..door.clone() };
    assert!(matches!(
        client.put_anchor("place", &flat),
        Err(ClientError::Anchor(ContentAnchorError::Rotation))
    ));
    assert_eq!(service.requests().len(), 7);
}
